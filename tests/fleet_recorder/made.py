"""Messages and recordings that tests of the recorder have in common."""

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from fleet_bus import keys
from fleet_bus.messages import Assignment, Event, EventKind, ScenarioDocument, ServiceStatus, StateSample
from fleet_bus.messages.state import ENCODING
from fleet_bus.pubsub import Received
from fleet_recorder import layout
from fleet_recorder.files import Folder
from fleet_recorder.layout import Recorded
from fleet_recorder.parts import Parts, Rules
from tests.memory_bus import Time
from vehicle_agent import svea

#: When messages of tests arrive, Unix ns.
T0 = 10**18
#: Takes all of the disk, and waits for no particular size or time.
RULES = Rules(keep_free=0)


def state(seq: int, vehicle: str = "a", *, epoch: int = 7, source: str = "agent", every: float = 0.05) -> Received:
    """A sample of a vehicle that moves on a line, put and arrived a little after its time."""
    t = T0 + round(seq * every * 1e9)
    sample = StateSample(epoch, seq, t, np.array([0.1 * seq, 0.0, 0.0, 1.0]), np.zeros(2))
    return Received(keys.state(vehicle), sample.encode(), ENCODING, t + 1000, source, t + 2000)


def profile(vehicle: str = "a", at: int = T0) -> Received:
    found = svea.profile()
    return Received(keys.profile(vehicle), found.encode(), found.encoding(), at, "agent", at + 1)


def assignment(time_zero: int, vehicle: str = "a", at: int = T0) -> Received:
    message = Assignment(scenario="s", vehicle=vehicle, time_zero=time_zero)
    return Received(keys.assignment("s", vehicle), message.encode(), message.encoding(), at, "side", at + 1)


def document(version: int, at: int = T0, text: str = "scenario: s") -> Received:
    message = ScenarioDocument(scenario="s", version=version, text=text)
    return Received(keys.document("s"), message.encode(), message.encoding(), at, "side", at + 1)


def event(kind: EventKind, at: int, vehicle: str = "a") -> Received:
    message = Event(kind=kind, vehicle=vehicle, t=at, source="reach-1", message="told")
    return Received(keys.event(vehicle), message.encode(), message.encoding(), at, "server", at + 1)


def status(at: int) -> Received:
    message = ServiceStatus(kind="reach", instance="one", t=at, started=T0)
    return Received(keys.service_status("reach", "one"), message.encode(), message.encoding(), at, "server", at + 1)


@contextmanager
def parts(folder: Path, rules: Rules = RULES, time: Time | None = None, **more: Any) -> Iterator[Parts]:
    """Parts of a recording in a folder, closed at the end."""
    with Folder(folder) as opened:
        writing = Parts(opened, rules, clock=time or Time(), **more)
        try:
            yield writing
        finally:
            writing.close()


def recorded(received: Received, number: int) -> Recorded:
    """A message that came as the recorder's ``number``-th."""
    return Recorded(received, number, received.arrived_ns)


def numbered(messages: Iterable[Received]) -> list[Recorded]:
    return [recorded(received, n) for n, received in enumerate(messages)]


def write(folder: Path, messages: Iterable[Received], **more: Any) -> Path:
    """Record messages to one file."""
    with parts(folder, **more) as writing:
        assert writing.ready()
        for message in numbered(messages):
            assert writing.add(message)
    (path,) = writing.files
    return path


def token(vehicle: str, alive: bool, at: int) -> Received:
    return layout.token(keys.alive(vehicle), alive, at)
