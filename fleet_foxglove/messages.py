"""What Foxglove shows of what comes over the bus, message by message; the same for who looks on and who records."""

import json
from collections.abc import Callable, Container, Iterable, Iterator
from functools import cache, partial
from typing import Any, Final

import structlog
from foxglove.messages import FrameTransform, Log, SceneUpdate

from fleet_bus import keys
from fleet_bus.errors import KeyIdError, MessageError
from fleet_bus.messages import Event, ReachTube, ScenarioDocument, StateSample, VehicleProfile
from fleet_bus.pubsub import Received
from fleet_foxglove import scene, topics
from fleet_foxglove.scene import Regions
from fleet_foxglove.topics import SceneMessage

_log = structlog.get_logger(__name__)

ALL_TOPICS: Final = frozenset(
    {topics.SCENE, topics.REGIONS, topics.TRANSFORMS, topics.ORIGIN, topics.NUMBERS, topics.LOG}
)
#: What a latecomer must get again, since it does not come by itself.
LASTING: Final = frozenset({topics.REGIONS, topics.ORIGIN})

#: The origin of the frame ``fleet`` is a multiple of this (units of the position), near the first vehicle.
ORIGIN_GRID: Final = 100.0

DrawRegions = Callable[[ScenarioDocument], Regions]
#: Encodes one message, which takes longer than to find out that there is one.
_Make = Callable[[], SceneMessage]

_TYPES: Final[dict[str, type[SceneUpdate] | type[FrameTransform] | type[Log]]] = {
    topics.SCENE: SceneUpdate,
    topics.REGIONS: SceneUpdate,
    topics.TRANSFORMS: FrameTransform,
    topics.ORIGIN: FrameTransform,
    topics.LOG: Log,
}


class Scene:
    """Remembers what later messages need: profiles, regions that wait for one, and where the fleet is.

    Args:
        draw_regions: what can be drawn of a scenario; may raise ``MessageError``. Without it no regions are drawn.
    """

    def __init__(self, draw_regions: DrawRegions | None = None) -> None:
        self._draw_regions = draw_regions
        self._profiles: dict[str, VehicleProfile] = {}
        self._waiting: dict[str, tuple[Regions, Received]] = {}
        self._origin: tuple[float, float] | None = None

    def scene_messages(self, received: Received, wanted: Container[str] = ALL_TOPICS) -> Iterable[SceneMessage]:
        """What a message of the bus looks like, on the topics of ``wanted``; nothing for messages that do not show.

        Scenes and transforms depend on the message and on the vehicle's profile alone: who looks on and who records get
        the same bytes. Raises ``MessageError`` with the reason for what is refused.
        """
        try:
            return [make() for topic, make in self._messages(received) if topic in wanted]
        except KeyIdError as error:
            raise MessageError("key", str(error)) from None

    def _messages(self, received: Received) -> Iterator[tuple[str, _Make]]:
        chunks = received.key.split("/")
        match chunks:
            case ["reach", _, "tube"]:
                yield from self._tube(keys.vehicle_of(received.key), received)
            case ["fleet", _, "state"]:
                yield from self._state(keys.vehicle_of(received.key), received)
            case ["fleet", _, "profile"]:
                yield from self._profile(keys.vehicle_of(received.key), received)
            case ["reach", _, "event"] | ["svc", _, _, "event"]:
                event = Event.decode(received.payload, received.encoding)
                yield topics.LOG, lambda: _encoded(topics.LOG, scene.event_log(event), received, event.t)
            case ["spec", scenario, "document"] if self._draw_regions is not None:
                document = ScenarioDocument.decode(received.payload, received.encoding)
                if document.scenario != scenario:
                    raise MessageError("key", f"a document of {document.scenario!r} came on {received.key!r:.120}")
                self._waiting[scenario] = self._draw_regions(document), received
                yield from self._placed()

    def _tube(self, vehicle: str, received: Received) -> Iterator[tuple[str, _Make]]:
        tube = ReachTube.decode(received.payload, received.encoding)
        if tube.vehicle != vehicle:
            raise MessageError("key", f"a tube of {tube.vehicle!r} came on {received.key!r:.120}")
        scene.timestamp(tube.t)
        if self._origin is None:
            x, y = (ORIGIN_GRID * round(float(tube.center[0, i]) / ORIGIN_GRID) for i in tube.position)
            self._origin = origin = x, y
            yield (
                topics.ORIGIN,
                lambda: _encoded(topics.ORIGIN, scene.origin_transform(tube.t, origin), received, tube.t),
            )
        profile = self._profiles.get(vehicle)
        yield topics.SCENE, lambda: _encoded(topics.SCENE, scene.tube_update(tube, profile), received, tube.t)
        yield topics.NUMBERS, lambda: _json(scene.numbers(tube, received.arrived_ns), received, tube.t)

    def _state(self, vehicle: str, received: Received) -> Iterator[tuple[str, _Make]]:
        sample = StateSample.decode(received.payload, received.encoding)
        profile = self._profiles.get(vehicle)
        if profile is None:
            raise MessageError("no_profile", f"a state of {vehicle}, whose profile has not come")
        transform = scene.vehicle_transform(vehicle, sample, profile)
        yield topics.TRANSFORMS, lambda: _encoded(topics.TRANSFORMS, transform, received, sample.t)

    def _profile(self, vehicle: str, received: Received) -> Iterator[tuple[str, _Make]]:
        self._profiles[vehicle] = VehicleProfile.decode(received.payload, received.encoding)
        yield from self._placed()

    def _placed(self) -> Iterator[tuple[str, _Make]]:
        """Regions of which a profile says that their states are the position; the others wait for one."""
        for name, (drawn, received) in list(self._waiting.items()):
            if any(_is_position(drawn.names, profile) for profile in self._profiles.values()):
                del self._waiting[name]
                for region, reason in drawn.left_out.items():
                    _log.info("region not drawn", scenario=name, region=region, reason=reason)
                yield topics.REGIONS, partial(_regions, drawn, received)


def _is_position(names: tuple[str, str], profile: VehicleProfile) -> bool:
    mapped = tuple(profile.maps_to.get(name, name) for name in names)
    return mapped == tuple(profile.state_names[i] for i in profile.position)


def _encoded(topic: str, message: Any, received: Received, t: int) -> SceneMessage:
    return SceneMessage(topic, *schema_of(topic), message.encode(), received.arrived_ns or t)


def _regions(drawn: Regions, received: Received) -> SceneMessage:
    t = received.arrived_ns
    return _encoded(topics.REGIONS, scene.regions_update(drawn, t), received, t)


def _json(message: dict[str, object], received: Received, t: int) -> SceneMessage:
    # The decoders let no NaN through; should one come anyway, it would make the message unreadable for Foxglove.
    payload = json.dumps(message, allow_nan=False).encode()
    return SceneMessage(topics.NUMBERS, *schema_of(topics.NUMBERS), payload, received.arrived_ns or t)


@cache
def schema_of(topic: str) -> tuple[str, str, bytes, str]:
    """Of a topic: name, encoding and data of its schema, and the encoding of its messages."""
    if topic == topics.NUMBERS:
        return topics.NUMBERS_SCHEMA["title"], "jsonschema", json.dumps(topics.NUMBERS_SCHEMA).encode(), "json"
    schema = _TYPES[topic].get_schema()
    return schema.name, schema.encoding, schema.data, "protobuf"
