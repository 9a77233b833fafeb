"""From bytes to batches: what cannot be accepted is counted by reason, and takes nothing else along."""

import numpy as np

from fleet_bus.messages import StateSample
from fleet_bus.messages.state import ENCODING
from fleet_bus.pubsub import Received
from fleet_bus.rejections import Rejections
from reach_server.service.ingest import Ingest


def sample(seq: int, n: int = 2) -> StateSample:
    return StateSample(1, seq, 10 + seq, np.arange(float(n)), np.array([0.5]))


def received(key: str, payload: bytes, encoding: str = ENCODING) -> Received:
    return Received(key, payload, encoding, None)


def test_samples_are_grouped_and_keep_their_vehicles() -> None:
    ingest = Ingest(Rejections())
    for vehicle, seq, n in (("a", 0, 2), ("b", 7, 3), ("a", 1, 2), ("b", 8, 2)):
        ingest.put(received(f"fleet/{vehicle}/state", sample(seq, n).encode()))
    found = {
        (vehicle, int(seq)): batch.states.x.shape[1]
        for batch in ingest.drain()
        for vehicle, seq in zip(batch.vehicles, batch.states.seq, strict=True)
    }
    assert found == {("a", 0): 2, ("b", 7): 3, ("a", 1): 2, ("b", 8): 2}
    assert ingest.drain() == []
    assert ingest.received == 4


def test_what_is_refused_is_counted_and_the_rest_goes_through() -> None:
    rejections = Rejections()
    ingest = Ingest(rejections)
    good = sample(0).encode()
    # No encoder makes it.
    broken = good.replace(np.float64(0.5).tobytes(), np.float64(np.nan).tobytes())
    for key, payload, encoding in (
        ("fleet/a/state", good, ENCODING),
        ("fleet/a/state", broken, ENCODING),
        ("fleet/a/state", b"\x00", ENCODING),
        ("fleet/a/state", good, "text/plain"),
        ("fleet/@x/state", good, ENCODING),
        ("fleet/b/state", good, ENCODING),
    ):
        ingest.put(received(key, payload, encoding))
    vehicles = [vehicle for batch in ingest.drain() for vehicle in batch.vehicles]
    assert sorted(vehicles) == ["a", "b"]
    counts = rejections.snapshot()
    assert sum(counts.values()) == 4
    assert counts["not_finite"] == 1
    assert counts["key"] == 1


def test_beyond_the_limit_messages_are_counted_as_overflow() -> None:
    rejections = Rejections()
    ingest = Ingest(rejections, limit=2)
    for seq in range(5):
        ingest.put(received("fleet/a/state", sample(seq).encode()))
    assert rejections.snapshot() == {"overflow": 3}
    assert sum(len(batch.vehicles) for batch in ingest.drain()) == 2
    ingest.put(received("fleet/a/state", sample(5).encode()))
    assert len(ingest.drain()) == 1
