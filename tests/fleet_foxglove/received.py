"""Messages as they come from the bus."""

from fleet_bus import keys
from fleet_bus.messages import Document, ReachTube, StateSample
from fleet_bus.messages import state as state_message
from fleet_bus.messages import tube as tube_message
from fleet_bus.pubsub import Received
from tests.fleet_bus.messages.examples import T0

ARRIVED = T0 + 80_000_000


def received(key: str, payload: bytes, encoding: str, source: str = "one") -> Received:
    return Received(key, payload, encoding, None, source, ARRIVED)


def tube(sent: ReachTube, source: str = "one") -> Received:
    return received(keys.tube(sent.vehicle), sent.encode(), tube_message.ENCODING, source)


def state(vehicle: str, sent: StateSample) -> Received:
    return received(keys.state(vehicle), sent.encode(), state_message.ENCODING)


def document(key: str, sent: Document) -> Received:
    return received(key, sent.encode(), sent.encoding())
