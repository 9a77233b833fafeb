"""What Foxglove is sent says what the messages of the bus say, read by a decoder that shares no code with its SDK."""

import json
import math
from typing import Any

import jsonschema
import numpy as np
import pytest
from hypothesis import given

from fleet_bus import keys
from fleet_bus.errors import MessageError
from fleet_bus.messages import (
    Audit,
    Event,
    EventKind,
    Label,
    ReachTube,
    ScenarioDocument,
    VehicleProfile,
    parse_profile,
)
from fleet_foxglove import scene, topics
from fleet_foxglove.messages import ALL_TOPICS, ORIGIN_GRID, Scene, schema_of
from fleet_foxglove.scene import Region, Regions
from tests.fleet_bus.messages.examples import T0, a_profile, a_sample, a_tube, profile_fields, tubes
from tests.fleet_foxglove import received
from tests.fleet_foxglove.client import content_of

SQUARE = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 0.0]])


def shown(view: Scene, what: Any) -> dict[str, dict[str, Any]]:
    """By topic, what a message looks like; one message a topic."""
    messages = list(view.scene_messages(what))
    found = {message.topic: content_of(message) for message in messages}
    assert len(found) == len(messages)
    return found


def entities(view: Scene, sent: ReachTube) -> dict[str, dict[str, Any]]:
    update = shown(view, received.tube(sent))[topics.SCENE]
    assert update["deletions"] == []
    return {entity["id"]: entity for entity in update["entities"]}


def introduced(profile: VehicleProfile, draw: Any = None) -> Scene:
    """A scene that knows the profile of ``svea1``."""
    view = Scene(draw)
    list(view.scene_messages(received.document(keys.profile("svea1"), profile)))
    return view


def corners(primitive: dict[str, Any]) -> np.ndarray[Any, np.dtype[np.float64]]:
    """Vertices (K, 2) relative to the primitive's pose, which does not turn them."""
    assert primitive["pose"]["orientation"] == {"x": 0, "y": 0, "z": 0, "w": 1.0}
    assert all(point["z"] == 0 for point in primitive["points"])
    return np.array([[point["x"], point["y"]] for point in primitive["points"]]).reshape(-1, 2)


def place(primitive: dict[str, Any]) -> tuple[float, float]:
    position = primitive["pose"]["position"]
    return position["x"], position["y"]


@pytest.mark.property
@pytest.mark.slow
@given(tubes())
def test_vertices_and_centers_are_those_of_the_tube_to_the_last_bit(sent: ReachTube) -> None:
    if sent.t >= scene.LATEST:
        with pytest.raises(MessageError) as caught:
            list(Scene().scene_messages(received.tube(sent)))
        assert caught.value.reason == "range"
        return
    decoded = ReachTube.decode(sent.encode())
    entity = entities(Scene(), sent)[f"tube/{sent.vehicle}"]
    corner_count = decoded.outline.shape[1]
    assert len(entity["lines"]) == (len(decoded.times) if corner_count else 0)
    centers = decoded.center[:, list(decoded.position)]
    for line, center, outline in zip(entity["lines"], centers, decoded.outline, strict=False):
        assert line["type"] == 1  # a loop
        assert place(line) == tuple(center)
        assert np.array_equal(corners(line), outline.astype(np.float64))
    assert len(entity["triangles"]) == (corner_count >= 3)
    for filled in entity["triangles"]:
        assert place(filled) == tuple(centers[-1])
        assert np.array_equal(corners(filled), decoded.outline[-1].astype(np.float64))


def test_a_tube_a_thousand_kilometres_away_loses_no_millimetre_in_single_precision() -> None:
    far = np.array([1e6 + 0.123456, -2e6 - 0.654321])
    center = np.zeros((3, 4))
    center[:, :2] = far
    (line, *_) = entities(Scene(), a_tube(center=center))["tube/svea1"]["lines"]
    assert place(line) == tuple(far)
    relative = corners(line)
    assert np.abs(relative - relative.astype(np.float32)).max() == 0
    # What it would be with the vertices in the world.
    world = far + relative
    assert np.abs(world - world.astype(np.float32)).max() > 0.01


def test_triangles_cover_the_outline_once() -> None:
    angles = np.linspace(0, 2 * np.pi, 7, endpoint=False)
    outline = np.broadcast_to(np.stack([3 * np.cos(angles), np.sin(angles)], axis=1), (3, 7, 2))
    (filled,) = entities(Scene(), a_tube(outline=outline))["tube/svea1"]["triangles"]
    a, b, c = corners(filled)[np.array(filled["indices"]).reshape(-1, 3)].transpose(1, 0, 2)
    areas = ((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]) / 2
    assert len(areas) == 5
    assert (areas > 0).all()
    assert areas.sum() == pytest.approx(7 / 2 * 3 * math.sin(2 * np.pi / 7), rel=1e-6)


def test_the_label_is_seen_by_colour_and_read_in_the_text_and_later_steps_fade() -> None:
    found = set()
    for label in Label:
        entity = entities(Scene(), a_tube(label=label))["tube/svea1"]
        (text,) = entity["texts"]
        assert text["text"] == f"svea1 {label}"
        colors = [tuple(line["color"][part] for part in "rgb") for line in entity["lines"]]
        assert set(colors) == {scene.COLORS[label]}
        found.add(colors[0])
        opacity = [line["color"]["a"] for line in entity["lines"]]
        assert opacity == sorted(opacity, reverse=True)
        assert 0 < opacity[-1] < opacity[0] == 1
    assert len(found) == len(Label)


@pytest.mark.parametrize(
    ("step", "seconds"), [(50_000_000, 2.0), (10**9, 5.0), (60 * 10**9, 300.0), (10**15, 300.0), (-1, 2.0)]
)
def test_what_gets_old_vanishes_by_itself(step: int, seconds: float) -> None:
    found = entities(introduced(a_profile()), a_tube(times=T0 + step * np.arange(1, 4)))
    assert set(found) == {"tube/svea1", "heading/svea1"}
    for entity in found.values():
        assert entity["lifetime"]["seconds"] + entity["lifetime"]["nanos"] / 1e9 == seconds
        assert entity["timestamp"] == {"seconds": T0 // 10**9, "nanos": 0}


def test_the_vehicle_stands_where_it_was_measured_and_its_arrow_points_along_its_heading() -> None:
    view = introduced(a_profile())
    yaw = -2.5
    transform = shown(view, received.state("svea1", a_sample(x=np.array([1e6 + 0.25, -3.0, yaw, 0.3]))))[
        topics.TRANSFORMS
    ]
    assert (transform["parent_frame_id"], transform["child_frame_id"]) == ("world", "vehicle/svea1")
    assert (transform["translation"]["x"], transform["translation"]["y"]) == (1e6 + 0.25, -3.0)
    turned = transform["rotation"]
    assert 2 * math.atan2(turned["z"], turned["w"]) == pytest.approx(yaw)
    assert (turned["x"], turned["y"]) == (0, 0)
    heading = entities(view, a_tube())["heading/svea1"]
    assert heading["frame_id"] == "vehicle/svea1"
    (arrow,) = heading["arrows"]
    assert place(arrow) == (0, 0)
    assert arrow["pose"]["orientation"]["w"] == 1
    assert arrow["shaft_length"] > 0


def test_a_vehicle_without_heading_or_profile_has_no_arrow() -> None:
    fields = profile_fields() | {"frame": "world", "roles": {"position": ["x", "y"]}, "lipschitz": None}
    view = introduced(parse_profile(fields))
    assert set(entities(view, a_tube())) == {"tube/svea1"}
    transform = shown(view, received.state("svea1", a_sample()))[topics.TRANSFORMS]
    assert transform["rotation"] == {"x": 0, "y": 0, "z": 0, "w": 1.0}
    assert set(entities(Scene(), a_tube())) == {"tube/svea1"}


def test_the_frame_of_the_fleet_is_near_its_first_vehicle_and_stays() -> None:
    view = Scene()
    center = np.full((3, 4), 1_234_567.0)
    origin = shown(view, received.tube(a_tube(center=center)))[topics.ORIGIN]
    assert (origin["parent_frame_id"], origin["child_frame_id"]) == ("world", "fleet")
    assert origin["translation"] == {"x": 1_234_600.0, "y": 1_234_600.0, "z": 0}
    assert ORIGIN_GRID == 100
    assert topics.ORIGIN not in shown(view, received.tube(a_tube()))


def test_numbers_are_those_of_the_tube_and_fit_their_schema() -> None:
    sent = a_tube(
        area=np.array([1.0, 2.0, 3.0]), area_free=np.array([1.0, 2.0, 4.5]), verdicts={"lot.leaves": "pending"}
    )
    numbers = shown(Scene(), received.tube(sent))[topics.NUMBERS]
    jsonschema.validate(numbers, topics.NUMBERS_SCHEMA)
    assert set(numbers) == set(topics.NUMBERS_SCHEMA["properties"])
    assert (numbers["vehicle"], numbers["label"]) == ("svea1", "guaranteed")
    assert (numbers["area"], numbers["area_free"], numbers["first_area"]) == (3.0, 4.5, 1.0)
    assert (numbers["coverage"], numbers["checked"], numbers["misses"]) == (0.9, 10, 1)
    assert (numbers["compute_ms"], numbers["age_ms"]) == (pytest.approx(10.0), 80.0)
    assert numbers["verdicts"] == [{"name": "lot.leaves", "verdict": "pending"}]
    unknown = scene.numbers(a_tube(audit=Audit()), 0)
    assert (unknown["coverage"], unknown["age_ms"]) == (None, None)
    jsonschema.validate(json.loads(json.dumps(unknown, allow_nan=False)), topics.NUMBERS_SCHEMA)


@pytest.mark.parametrize(
    ("kind", "level"),
    [(EventKind.CONTRADICTION, 4), (EventKind.TWO_SOURCES, 4), (EventKind.MISS, 3), (EventKind.ONE_SOURCE, 2)],
)
def test_events_are_log_entries(kind: EventKind, level: int) -> None:
    event = Event(kind=kind, vehicle="svea1", t=T0, source="reach-1", message="what happened")
    entry = shown(Scene(), received.document(keys.event("svea1"), event))[topics.LOG]
    assert (entry["level"], entry["name"]) == (level, "reach-1/svea1")
    assert entry["message"] == f"{kind}: what happened"
    of_service = event.model_copy(update={"vehicle": None})
    entry = shown(Scene(), received.document(keys.service_event("reach", "reach-1"), of_service))[topics.LOG]
    assert entry["name"] == "reach-1"


def lot(names: tuple[str, str]) -> Any:
    def draw(document: ScenarioDocument) -> Regions:
        return Regions(document.scenario, names, [Region("P", [SQUARE + 1e6]), Region("Q", [])], {"R": "why"})

    return draw


DOCUMENT = received.document(keys.document("lot"), ScenarioDocument(scenario="lot", version=1, text="-"))


def test_regions_are_drawn_once_a_profile_says_where_their_states_are() -> None:
    view = Scene(lot(("x1", "x2")))
    assert shown(view, DOCUMENT) == {}
    # Its names are not mapped to this one's position.
    other = parse_profile(profile_fields() | {"maps_to": {"x1": "y", "x2": "x"}})
    assert shown(view, received.document(keys.profile("other"), other)) == {}
    update = shown(view, received.document(keys.profile("svea1"), a_profile()))[topics.REGIONS]
    (entity,) = update["entities"]
    assert (entity["id"], entity["frame_id"], entity["lifetime"]) == ("scenario/lot", "world", None)
    (line,) = entity["lines"]
    assert line["type"] == 0
    assert np.array_equal(corners(line) + place(line), SQUARE + 1e6)
    assert [text["text"] for text in entity["texts"]] == ["lot.P"]
    # The next version replaces it at once.
    assert set(shown(view, DOCUMENT)) == {topics.REGIONS}


def test_regions_are_left_out_where_nothing_draws_them() -> None:
    assert shown(introduced(a_profile()), DOCUMENT) == {}


def test_who_records_gets_the_bytes_that_who_looks_on_gets() -> None:
    looking, recording = introduced(a_profile()), introduced(a_profile())
    # The two saw different things before.
    list(recording.scene_messages(received.tube(a_tube(vehicle="svea2", center=np.full((3, 4), 1e5)))))
    for message in (received.tube(a_tube()), received.state("svea1", a_sample())):
        one = {m.topic: m for m in looking.scene_messages(message) if m.topic != topics.ORIGIN}
        two = {m.topic: m for m in recording.scene_messages(message)}
        assert one == two
        assert one


def test_only_what_is_wanted_is_made() -> None:
    view = introduced(a_profile())
    message = received.tube(a_tube())
    assert [m.topic for m in view.scene_messages(message, {topics.NUMBERS})] == [topics.NUMBERS]
    assert list(view.scene_messages(message, ())) == []


def test_every_topic_has_a_schema() -> None:
    for topic in ALL_TOPICS:
        name, encoding, data, message_encoding = schema_of(topic)
        assert name
        assert data
        assert (encoding, message_encoding) in {("protobuf", "protobuf"), ("jsonschema", "json")}
    jsonschema.Draft202012Validator.check_schema(topics.NUMBERS_SCHEMA)


def refused(view: Scene, message: Any) -> str:
    with pytest.raises(MessageError) as caught:
        list(view.scene_messages(message))
    return caught.value.reason


def test_what_is_wrong_is_refused_with_its_reason() -> None:
    good = received.tube(a_tube())
    assert refused(Scene(), received.received(good.key, good.payload[:-1], good.encoding)) == "malformed"
    assert refused(Scene(), received.received(good.key, good.payload, good.encoding[:-1] + "9")) == "version"
    assert refused(Scene(), received.received(good.key, b"", "zenoh/bytes")) == "encoding"
    assert refused(Scene(), received.received("reach/other/tube", good.payload, good.encoding)) == "key"
    assert refused(Scene(), received.received("reach/ä b/tube", good.payload, good.encoding)) == "key"
    nan = good.payload.replace(np.float64(1.0).tobytes(), np.float64(np.nan).tobytes())
    assert refused(Scene(), received.received(good.key, nan, good.encoding)) == "not_finite"
    assert refused(Scene(), received.state("svea1", a_sample())) == "no_profile"
    assert refused(introduced(a_profile()), received.state("svea1", a_sample(x=np.zeros(3)))) == "profile"
    late = scene.LATEST
    assert refused(Scene(), received.tube(a_tube(t=late))) == "range"
    assert refused(introduced(a_profile()), received.state("svea1", a_sample(t=late))) == "range"
    event = Event(kind=EventKind.MISS, vehicle="svea1", t=late, source="reach-1", message="m")
    assert refused(Scene(), received.document(keys.event("svea1"), event)) == "range"
    other = received.received(keys.document("other"), DOCUMENT.payload, DOCUMENT.encoding)
    assert refused(Scene(lot(("x", "y"))), other) == "key"


@pytest.mark.parametrize("key", ["fleet/svea1/truth", "fleet/svea1/alive", "svc/reach/a/status", "odd", "spec/a/b/c"])
def test_what_has_no_picture_is_passed_over(key: str) -> None:
    assert list(Scene().scene_messages(received.received(key, b"\xff", "zenoh/bytes"))) == []
