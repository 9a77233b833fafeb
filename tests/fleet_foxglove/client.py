"""A client of Foxglove's WebSocket protocol, and what it needs to read messages: shares no code with Foxglove's SDK."""

import base64
import json
import struct
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

from websockets.sync.client import ClientConnection, connect
from websockets.typing import Subprotocol

from fleet_foxglove.topics import SceneMessage
from tests.fleet_foxglove import protobuf
from tests.waiting import DEADLINE

PROTOCOL = Subprotocol("foxglove.sdk.v1")
_HEADER = struct.Struct("<BIQ")
_MESSAGE_DATA = 1


@dataclass(frozen=True)
class Message:
    """What came on a topic, as bytes and as what they say."""

    topic: str
    t_ns: int
    payload: bytes
    channel: dict[str, Any]

    @property
    def content(self) -> dict[str, Any]:
        schema: str = self.channel["schema"]
        binary = self.channel["schemaEncoding"] == "protobuf"
        data = base64.b64decode(schema + "=" * (-len(schema) % 4)) if binary else schema.encode()
        return content(self.channel["encoding"], self.channel["schemaName"], data, self.payload)


def content(encoding: str, schema_name: str, schema: bytes, payload: bytes) -> dict[str, Any]:
    """What a payload says, read by the schema that it was announced with."""
    if encoding == "json":
        found: dict[str, Any] = json.loads(payload, parse_constant=_refuse)
        return found
    assert encoding == "protobuf"
    return protobuf.decode(payload, protobuf.read_schema(schema), f".{schema_name}")


def content_of(message: SceneMessage) -> dict[str, Any]:
    """What a recorded message says."""
    return content(message.message_encoding, message.schema_name, message.schema_data, message.payload)


def _refuse(name: str) -> Any:
    raise AssertionError(f"{name} is no JSON")


@dataclass
class Client:
    connection: ClientConnection
    info: dict[str, Any] = field(default_factory=dict)
    channels: dict[str, dict[str, Any]] = field(default_factory=dict)
    _topics: dict[int, str] = field(default_factory=dict)

    def read_announcements(self, count: int) -> None:
        """Wait for what the server says of itself and of so many topics."""
        while not self.info or len(self.channels) < count:
            told = json.loads(self.connection.recv(timeout=DEADLINE))
            if told["op"] == "serverInfo":
                self.info = told
            elif told["op"] == "advertise":
                self.channels |= {channel["topic"]: channel for channel in told["channels"]}

    def subscribe(self, *topics: str) -> None:
        numbers = {len(self._topics) + i + 1: topic for i, topic in enumerate(topics)}
        self._topics |= numbers
        subscriptions = [{"id": id, "channelId": self.channels[topic]["id"]} for id, topic in numbers.items()]
        self.connection.send(json.dumps({"op": "subscribe", "subscriptions": subscriptions}))

    def next(self, wanted: Callable[[Message], bool] = lambda _: True) -> Message:
        """The next message that is wanted."""
        while True:
            raw = self.connection.recv(timeout=DEADLINE)
            if isinstance(raw, str):
                continue
            opcode, subscription, t_ns = _HEADER.unpack_from(raw)
            assert opcode == _MESSAGE_DATA
            topic = self._topics[subscription]
            message = Message(topic, t_ns, raw[_HEADER.size :], self.channels[topic])
            if wanted(message):
                return message


@contextmanager
def connected(port: int, topics: int) -> Iterator[Client]:
    """A client that has been told of so many topics."""
    with connect(f"ws://127.0.0.1:{port}", subprotocols=[PROTOCOL], open_timeout=DEADLINE) as connection:
        client = Client(connection)
        client.read_announcements(topics)
        yield client
