"""The fleet as a server sees it: who is known, whose samples are let in, which scenarios act, and the rounds.

No network and no clock in here: messages, and the times at which they came, in; tubes and events out.
"""

from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from fleet_bus.errors import MessageError
from fleet_bus.messages import Assignment, ScenarioDocument, VehicleProfile
from fleet_bus.rejections import Rejections
from fleet_bus.writers import Source
from reach_server.data.events import EngineEvent
from reach_server.data.window import SampleBatch
from reach_server.engine.engine import Engine, PlannedInputs, unheeded
from reach_server.engine.results import Checks, Tubes
from reach_server.service import object_reader, object_writer
from reach_server.service.ingest import VehicleBatch
from reach_server.service.object_graph import CheckpointError
from reach_server.service.profiles import Profiles
from reach_server.service.registry import VehicleRegistry
from reach_server.service.sample_admission import SampleAdmission
from reach_server.service.sample_rows import by_plan, rows_of
from reach_server.service.scenario_assignments import ScenarioAssignments

#: What a window refuses, or takes with a reservation, as it is counted: name in ``Appended``, reason, detail.
SETTLED: Final = (
    ("backwards", "range", "a stamp before that of an earlier sample"),
    ("stopped", "range", "a stamp equal to that of an earlier sample: is the clock of the agent stopped?"),
    ("leaped", "leap", "an epoch, a number or a stamp leaps: wrong, or another source"),
    ("not_finite", "not_finite", "a state that is no number"),
    ("no_input", "input_not_finite", "an input that is no number is taken as not recorded"),
    ("frozen_pose", "stale_pose", "the pose repeats although the vehicle moves: no transition is taken from it"),
    ("resynced", "resynced", "samples that were refused agree with each other: a new trajectory begins"),
)


@dataclass(frozen=True, slots=True)
class Outcome:
    """What one round of samples led to."""

    tubes: list[tuple[Engine, Tubes]]
    events: list[EngineEvent]
    stored: int
    repeated: int
    checks: Checks


class Fleet:
    """Vehicles, their classes, the scenarios and who takes part in them.

    ``stamp`` tells the time of events that no sample tells (ns since the Unix epoch). ``source`` names the session that
    sent a message, ``now`` (s) is when it came, by any clock that never goes back; without it the newest stamp tells
    the time.
    """

    def __init__(self, rejections: Rejections, stamp: Callable[[], int] | None = None) -> None:
        self._rejections = rejections
        self._stamp = stamp
        self._registry = VehicleRegistry(stamp)
        self._scenarios = ScenarioAssignments(self._registry)
        self._profiles = Profiles(self._registry, self._scenarios, rejections)
        self._admission = SampleAdmission(self._registry, self._profiles, self._scenarios, rejections)

    def snapshot(self) -> bytes:
        """All that the next rounds depend on; raises ``CheckpointError`` for what cannot be written."""
        return object_writer.dump(self, {"rejections": self._rejections, "stamp": self._stamp})

    @classmethod
    def restored(cls, snapshot: bytes, rejections: Rejections, stamp: Callable[[], int] | None = None) -> "Fleet":
        """A fleet that goes on as the one goes whose snapshot this is, to the last bit; raises ``CheckpointError`` for
        bytes that are none, or of another version of the program."""
        fleet = object_reader.load(snapshot, {"rejections": rejections, "stamp": stamp})
        if not isinstance(fleet, cls):
            raise CheckpointError(f"a {type(fleet).__name__} where a fleet is expected")
        return fleet

    @property
    def engines(self) -> tuple[Engine, ...]:
        """One engine per vehicle class."""
        return self._registry.engines

    @property
    def vehicles(self) -> tuple[str, ...]:
        """Ids of the vehicles that are known."""
        return tuple(self._registry.vehicles)

    def profile_of(self, vehicle: str) -> VehicleProfile | None:
        """Profile of a vehicle, if it has come."""
        known = self._registry.vehicles.get(vehicle)
        return None if known is None else known.profile

    def heard(self, vehicle: str) -> float | None:
        """When the newest sample of a vehicle came (s), if one did."""
        known = self._registry.vehicles.get(vehicle)
        return None if known is None or known.heard == -float("inf") else known.heard

    def interval(self, vehicle: str) -> float:
        """Sample time of a vehicle (s), 0 where it is not known."""
        profile = self.profile_of(vehicle)
        return 0.0 if profile is None else profile.sample_time

    def waits_for_profile(self, vehicle: str) -> bool:
        """Whether samples of a vehicle wait for a profile."""
        known = self._registry.vehicles.get(vehicle)
        return known is not None and bool(known.kept) and known.served is None

    def scenario_source(self, name: str) -> str:
        """Session of the service that publishes a scenario, empty where nobody does."""
        return self._scenarios.source(name)

    def clock_offsets(self) -> dict[str, tuple[float, float]]:
        """By vehicle, by how much its clock is ahead of the server's at least, and the spread of that (s)."""
        return {
            vehicle: (known.clock.offset, known.clock.spread)
            for vehicle, known in self._registry.vehicles.items()
            if known.clock.known
        }

    def window_keys(self, vehicle: str) -> list[tuple[int, int]]:
        """(epoch, seq) of the samples in a vehicle's window."""
        known = self._registry.vehicles.get(vehicle)
        return [] if known is None or known.engine is None else known.engine.window.keys(known.slot)

    def first_sample(self, vehicle: str) -> tuple[int, int] | None:
        """(epoch, seq) of the first sample seen of the newest epoch of a vehicle."""
        known = self._registry.vehicles.get(vehicle)
        return None if known is None else known.first

    def set_profile(
        self, vehicle: str, profile: VehicleProfile, source: str = "", now: float | None = None
    ) -> list[EngineEvent]:
        """Take over a profile. Another one than before moves the vehicle to another class, with an empty window.

        That of another session than the one that writes the vehicle's states is kept for the case that this session
        comes to write them. Raises ``MessageError`` for one that no engine can work with, and where another session's
        is in force.
        """
        return self._profiles.put(vehicle, profile, source, self._registry.advance(now))

    def set_scenario(self, document: ScenarioDocument, source: str = "", now: float | None = None) -> list[EngineEvent]:
        """Take over a scenario; raise ``MessageError`` if its document is not to be taken."""
        return self._scenarios.put_document(document, source, self._registry.advance(now))

    def assign(self, assignment: Assignment, source: str = "", now: float | None = None) -> list[EngineEvent]:
        """Take over an assignment; it acts as soon as scenario and profile are there. Raises ``MessageError`` for one
        that does not come from the service that publishes the scenario."""
        return self._scenarios.put_assignment(assignment, source, self._registry.advance(now))

    def hear_service(self, source: str, now: float) -> None:
        """A side-info service was heard."""
        self._scenarios.hear(source, now)

    def elapse(self, now: float) -> list[EngineEvent]:
        """What happens because time has passed: whose turn it is to write, and which scenarios come into force."""
        self._registry.advance(now)
        return [*self._admission.elapse(now), *self._scenarios.elapse(now)]

    @property
    def clocks_off(self) -> int:
        """Vehicles whose clocks are not believed."""
        return len(self._registry.clocks_off)

    def mark_gone(self, vehicle: str) -> None:
        """A vehicle is certainly gone: it need not have been silent for ``SILENT`` seconds to be let go."""
        if (known := self._registry.vehicles.get(vehicle)) is not None:
            known.gone = True

    def let_go(self, now: float) -> list[str]:
        """Forget vehicles that have been silent for long, or that more than enough are silent beside; their ids."""
        gone = self._registry.let_go(now)
        for vehicle in gone:
            self._admission.forget(vehicle)
            self._scenarios.forget(vehicle)
        return gone

    def process(
        self,
        batches: list[VehicleBatch],
        now: float | None = None,
        passed: Callable[[str], object] = unheeded,
    ) -> Outcome:
        """Store all samples and compute a tube from the newest one of each vehicle that got any; ``passed`` is told
        when a stage is over."""
        stamps = [int(batch.states.t.max()) for batch in batches if len(batch.states.t)]
        now = self._registry.advance(max(stamps, default=0) / 1e9 if now is None else now)
        events: list[EngineEvent] = []
        parts: defaultdict[int, list[SampleBatch]] = defaultdict(list)
        for batch in batches:
            for (vehicle, session, epoch), rows in batch.by_writer().items():
                known = self._registry.known(vehicle)
                if known is None:
                    self._admission.refuse("overflow", self._registry.full, vehicle, len(rows))
                    continue
                every = len(rows) == len(batch.vehicles)
                states = batch.states if every else rows_of(batch.states, np.array(rows))
                arrived = None if batch.arrived_ns is None else batch.arrived_ns[rows]
                for part in self._admission.admit(vehicle, known, states, Source(session, epoch), arrived, now, events):
                    parts[id(known.engine)].append(part)
        passed("admit")
        engines = {id(engine): engine for engine in self._registry.engines}
        checks = Checks()
        tubes: list[tuple[Engine, Tubes]] = []
        stored = repeated = 0
        for key, samples in parts.items():
            engine = engines[key]
            joined = SampleBatch.join(samples)
            slots = np.unique(joined.vehicle)
            before, checked = engine.window.newest(slots), engine.checks
            appended, found = engine.append(joined)
            checks += engine.checks - checked
            # What caches repeat may be older than all that a full window holds.
            stored, repeated = stored + appended.stored, repeated + appended.repeated + appended.too_old
            for field, reason, detail in SETTLED:
                if number := getattr(appended, field):
                    self._rejections.count(MessageError(reason, detail), "fleet/*/state", number)
            events += self._admission.check_intervals(engine, slots)
            events += found
            after = engine.window.newest(slots)
            # What an agent's cache repeats fills the window, it is no reason for another tube.
            slots = slots[(before[0] != after[0]) | (before[1] != after[1]) | (before[2] != after[2])]
            passed("append")
            for group, known_inputs in self._by_plan(engine, slots) if len(slots) else []:
                result = engine.predict(group, known_inputs, passed)
                events += result.events
                result = result.noted(self._registry.clocks_off)
                tubes.append((engine, result.noted(self._admission.conflicts, contradicted=True)))
        return Outcome(tubes, events, stored, repeated, checks)

    def _by_plan(self, engine: Engine, slots: NDArray[np.intp]) -> list[tuple[NDArray[np.intp], PlannedInputs | None]]:
        if engine.profile.future_inputs != "plan":
            return [(slots, None)]
        epoch, seq, _, _ = engine.window.newest(slots)
        newest = list(zip(epoch.tolist(), seq.tolist(), strict=True))
        plans = [self._registry.vehicles[engine.vehicles[slot]].plan for slot in slots]
        return by_plan(slots, newest, plans, engine.horizon - 1)
