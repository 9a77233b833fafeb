"""How a message of the bus lies in an MCAP file, and what tells it from other channels there.

Payloads are kept as they came. What else a message has stands in its channel, one for each key, source and encoding;
the times of arrival and of the put are those of the MCAP message, its sequence counts what came to the recorder.
"""

from collections.abc import Mapping
from functools import cache
from typing import Final, NamedTuple

from fleet_bus import codec, schemas
from fleet_bus.errors import MessageError, RecordingError
from fleet_bus.messages import Event, ReachTube, ServiceStatus, StateSample
from fleet_bus.pubsub import Received

#: Version of the rules in this module.
FORMAT: Final = 1
#: What the header of a file calls its contents, and the metadata record that describes the recording.
PROFILE: Final = "fleet-reach"
DETAILS: Final = "fleet_recording"

#: Names in the metadata of a channel. The first holds ``FORMAT``, or ``SCENE`` for channels that only viewers read.
FLEET: Final = "fleet"
SCENE: Final = "scene"
SOURCE: Final = "source"
ENCODING: Final = "encoding"
#: Present where the MCAP message's time of publishing is the stamp of the put.
STAMPED: Final = "stamped"
#: Time of arrival of a message that was repeated at the beginning of a later file, whose log time is that beginning.
CARRIED: Final = "arrived_ns"

#: A liveliness token that came or went, as a message on the token's key.
TOKEN: Final = codec.encoding("fleet.token", 1)
_TOKEN_SCHEMA: Final = b"""\
{
  "$schema": "https://json-schema.org/draft/2020-12/schema",
  "$id": "urn:fleet-reach:fleet.token.v1",
  "title": "Token",
  "description": "A liveliness token came (true), or went out of sight (false).",
  "type": "object",
  "properties": {"alive": {"type": "boolean"}},
  "required": ["alive"],
  "additionalProperties": false
}
"""
_TOKEN_BYTES: Final = 64

#: MCAP counts times in 64 bits without a sign, and sequences in 32.
TIMES: Final = range(2**64)
SEQUENCES: Final = 2**32

_TIMED: Final[Mapping[str, type[StateSample | ReachTube | Event | ServiceStatus]]] = {
    "fleet.state": StateSample,
    "fleet.tube": ReachTube,
    "fleet.event": Event,
    "fleet.status": ServiceStatus,
}


class Recorded(NamedTuple):
    """A message of the bus in a recording.

    ``sequence`` counts what came to the recorder; where it jumps, messages were not recorded. ``logged_ns`` is when the
    message came, or, if it was ``carried`` over from before the file begins, when the file begins.
    """

    received: Received
    sequence: int
    logged_ns: int
    carried: bool = False


class SceneMessage(NamedTuple):
    """A message for viewers of the file, on a topic and of a schema of their own (``time_ns``: Unix ns)."""

    topic: str
    schema: str
    schema_encoding: str
    schema_data: bytes
    message_encoding: str
    payload: bytes
    time_ns: int


@cache
def known_schemas() -> Mapping[str, bytes]:
    """Name with version (``fleet.state.v1``) to JSON Schema of every message that this program knows."""
    shipped = {name.removesuffix(".json"): text.encode() for name, text in schemas.shipped().items()}
    return {**shipped, schema_name(TOKEN): _TOKEN_SCHEMA}


def schema_name(encoding: str) -> str:
    """Name with version of the schema in a Zenoh encoding; empty where it names none."""
    media_type, _, name = encoding.partition(";")
    return name if media_type == codec.MEDIA_TYPE else ""


def message_encoding(encoding: str) -> str:
    """What MCAP calls the encoding of such messages."""
    media_type = encoding.partition(";")[0]
    return "msgpack" if media_type == codec.MEDIA_TYPE else media_type


def token(key: str, alive: bool, arrived_ns: int) -> Received:
    """A token that came or went, as a message."""
    return Received(key, codec.pack({"alive": alive}), TOKEN, None, "", arrived_ns)


def is_alive(received: Received) -> bool:
    """Whether a message of a token says that it came; raise ``MessageError`` if it is none."""
    fields = codec.unpack(received.payload, limit=_TOKEN_BYTES)
    codec.check_fields(fields, {"alive": bool})
    return bool(fields["alive"])


def stays(received: Received) -> bool:
    """Whether a message is in force until the next one on its key: profile, document, assignment, status, token."""
    if received.encoding == TOKEN:
        return True
    role, *rest = received.key.split("/")
    return role == "spec" or (role, rest[1:]) == ("fleet", ["profile"]) or (role, rest[2:]) == ("svc", ["status"])


def metadata(received: Received, carried: bool) -> dict[str, str]:
    """Metadata of the channel on which a message lies."""
    found = {FLEET: str(FORMAT), ENCODING: received.encoding}
    if received.source:
        found[SOURCE] = received.source
    if received.timestamp_ns is not None:
        found[STAMPED] = "true"
    if carried:
        found[CARRIED] = str(received.arrived_ns)
    return found


def publish_time(received: Received, logged_ns: int) -> int:
    """When a message was put: by its stamp, else by the time in its payload, else when it was logged (Unix ns)."""
    if received.timestamp_ns is not None:
        return received.timestamp_ns
    name, _, _ = schema_name(received.encoding).rpartition(".v")
    if name in _TIMED:
        try:
            return _TIMED[name].decode(received.payload, received.encoding).t
        except MessageError:
            pass
    return logged_ns


def recorded(
    topic: str, metadata: Mapping[str, str], payload: bytes, *, log_time: int, publish_time: int, sequence: int
) -> Recorded:
    """The message of the bus that an MCAP message holds; raise ``RecordingError`` for metadata of no such channel."""
    arrived = metadata.get(CARRIED)
    try:
        arrived_ns = log_time if arrived is None else int(arrived)
    except ValueError:
        raise RecordingError(f"channel {topic!r:.120}: {CARRIED} is {arrived!r:.40}: expected nanoseconds") from None
    received = Received(
        topic,
        payload,
        metadata.get(ENCODING, ""),
        publish_time if STAMPED in metadata else None,
        metadata.get(SOURCE, ""),
        arrived_ns,
    )
    return Recorded(received, sequence, log_time, arrived is not None)
