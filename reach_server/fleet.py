"""The fleet as a server sees it: which vehicle belongs to which class, and one engine per class.

No network and no clock in here: messages in, tubes and events out.
"""

from collections import defaultdict
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from fleet_bus import keys
from fleet_bus.errors import MessageError, ScenarioError, UsageError
from fleet_bus.messages import Assignment, EventKind, ScenarioDocument, StateBatch, StateFlag, VehicleProfile
from fleet_bus.rejections import Rejections
from reach_server.engine import Engine, KnownInputs
from reach_server.ingest import VehicleBatch
from reach_server.inputs import limits
from reach_server.results import EngineEvent, Tubes
from reach_server.windows import Floats, SampleBatch
from side_info import Scenario

#: Samples of a vehicle without a profile that are kept for it.
KEPT_WITHOUT_PROFILE = 2000
#: What a window refuses, or takes with a reservation, as it is counted: name in ``Appended``, reason, detail.
SETTLED = (
    ("backwards", "range", "a stamp before that of an earlier sample"),
    ("stopped", "range", "a stamp equal to that of an earlier sample: is the clock of the agent stopped?"),
    ("leaped", "leap", "an epoch, a number or a stamp leaps: wrong, or another source"),
    ("not_finite", "not_finite", "a state that is no number"),
    ("no_input", "input_not_finite", "an input that is no number is taken as not recorded"),
    ("stale", "stale_pose", "the pose repeats although the vehicle moves: no transition is taken from it"),
    ("resynced", "resynced", "samples that were refused agree with each other: a new trajectory begins"),
)
#: Samples after which the sample interval is held against the profile.
INTERVAL_CHECK = 20


@dataclass(frozen=True, slots=True, eq=False)
class _Plan:
    """Inputs (steps, m) within a tolerance (m) that follow the sample ``key`` (epoch, seq)."""

    key: tuple[int, int]
    inputs: Floats
    tolerance: Floats


@dataclass(slots=True)
class _Vehicle:
    profile: VehicleProfile | None = None
    slot: int = -1
    kept: list[StateBatch] = field(default_factory=list)
    told: set[str] = field(default_factory=set)
    plan: "_Plan | None" = None
    first: tuple[int, int] | None = None


@dataclass(frozen=True, slots=True)
class Outcome:
    """What one round of samples led to."""

    tubes: list[tuple[Engine, Tubes]]
    events: list[EngineEvent]
    stored: int
    repeated: int


class Fleet:
    """Vehicles, their classes, the scenarios and who takes part in them."""

    def __init__(self, rejections: Rejections) -> None:
        self._rejections = rejections
        self._vehicles: defaultdict[str, _Vehicle] = defaultdict(_Vehicle)
        self._engines: dict[tuple[object, ...], Engine] = {}
        self._scenarios: dict[str, Scenario] = {}
        self._assignments: dict[tuple[str, str], Assignment] = {}

    @property
    def engines(self) -> tuple[Engine, ...]:
        """One engine per vehicle class."""
        return tuple(self._engines.values())

    def profile_of(self, vehicle: str) -> VehicleProfile | None:
        """Profile of a vehicle, if it has come."""
        known = self._vehicles.get(vehicle)
        return None if known is None else known.profile

    def window_keys(self, vehicle: str) -> list[tuple[int, int]]:
        """(epoch, seq) of the samples in a vehicle's window."""
        known = self._vehicles.get(vehicle)
        if known is None or known.profile is None:
            return []
        return self._engines[known.profile.shape_key()].window.keys(known.slot)

    def set_profile(self, vehicle: str, profile: VehicleProfile) -> list[EngineEvent]:
        """Take over a profile. Another one than before moves the vehicle to another class, with an empty window.

        Raises ``MessageError`` for one that no engine can work with.
        """
        known = self._vehicles[vehicle]
        if known.profile == profile:
            return []
        engine = self._engines.get(profile.shape_key())
        if engine is None:
            try:
                engine = self._engines[profile.shape_key()] = Engine(profile)
            except UsageError as error:
                # The one before, if there is one, stays in force.
                raise MessageError("fields", str(error)) from None
        if known.profile is not None:
            self._engines[known.profile.shape_key()].reset(vehicle)
        known.profile, known.slot, known.told, known.plan = profile, engine.add(vehicle), set(), None
        return [event for a in list(self._assignments.values()) if a.vehicle == vehicle for event in self._apply(a)]

    def set_scenario(self, document: ScenarioDocument) -> list[EngineEvent]:
        """Take over a scenario; raise ``MessageError`` if its document does not parse."""
        try:
            scenario = Scenario.parse(document.text, f"scenario {document.scenario}")
        except ScenarioError as error:
            raise MessageError("fields", str(error)) from None
        if (scenario.name, scenario.version) != (document.scenario, document.version):
            raise MessageError("fields", f"document {document.scenario} v{document.version} holds {scenario.name}")
        known = self._scenarios.get(scenario.name)
        if known is not None and known.text == scenario.text:
            # Published again: what was contradicted stays so.
            return []
        self._scenarios[scenario.name] = scenario
        return [
            event for a in list(self._assignments.values()) if a.scenario == scenario.name for event in self._apply(a)
        ]

    def assign(self, assignment: Assignment) -> list[EngineEvent]:
        """Take over an assignment; it acts as soon as scenario and profile are there."""
        self._assignments[assignment.scenario, assignment.vehicle] = assignment
        return self._apply(assignment)

    def _apply(self, assignment: Assignment) -> list[EngineEvent]:
        known = self._vehicles.get(assignment.vehicle)
        scenario = self._scenarios.get(assignment.scenario)
        if known is None or known.profile is None or scenario is None:
            return []
        engine = self._engines[known.profile.shape_key()]
        if not assignment.active:
            engine.unassign(assignment.vehicle, scenario.name)
            return []
        try:
            engine.assign(assignment.vehicle, scenario, assignment.time_zero, assignment.clock_offset)
        except ScenarioError as error:
            return [EngineEvent(EventKind.SCENARIO_REFUSED, assignment.vehicle, assignment.time_zero, str(error))]
        return []

    def first_sample(self, vehicle: str) -> tuple[int, int] | None:
        """(epoch, seq) of the first sample seen of the newest epoch of a vehicle."""
        known = self._vehicles.get(vehicle)
        return None if known is None else known.first

    def process(self, batches: list[VehicleBatch]) -> Outcome:
        """Store all samples and compute a tube from the newest one of each vehicle that got any."""
        events: list[EngineEvent] = []
        parts: defaultdict[int, list[SampleBatch]] = defaultdict(list)
        engines = {id(engine): engine for engine in self._engines.values()}
        for batch in batches:
            by_vehicle: defaultdict[str, list[int]] = defaultdict(list)
            for row, vehicle in enumerate(batch.vehicles):
                by_vehicle[vehicle].append(row)
            for vehicle, rows in by_vehicle.items():
                states = _rows(batch.states, np.array(rows))
                known = self._vehicles[vehicle]
                self._note_first(known, states)
                if known.profile is None:
                    events += self._keep(vehicle, known, states)
                    continue
                kept, known.kept = known.kept, []
                for part in (*kept, states):
                    accepted = self._accept(vehicle, known, known.profile, part, events)
                    if accepted is not None:
                        parts[id(self._engines[known.profile.shape_key()])].append(accepted)
        tubes: list[tuple[Engine, Tubes]] = []
        stored = repeated = 0
        for key, samples in parts.items():
            engine = engines[key]
            joined = SampleBatch.join(samples)
            slots = np.unique(joined.vehicle)
            before = engine.window.newest(slots)
            appended, found = engine.append(joined)
            # What caches repeat may be older than all that a full window holds.
            stored, repeated = stored + appended.stored, repeated + appended.repeated + appended.too_old
            for name, reason, detail in SETTLED:
                if number := getattr(appended, name):
                    self._rejections.count(MessageError(reason, detail), "fleet/*/state", number)
            events += self._check_intervals(engine, slots)
            events += found
            after = engine.window.newest(slots)
            # What an agent's cache repeats fills the window, it is no reason for another tube.
            slots = slots[(before[0] != after[0]) | (before[1] != after[1]) | (before[2] != after[2])]
            for group, known_inputs in self._by_plan(engine, slots) if len(slots) else []:
                result = engine.predict(group, known_inputs)
                events += result.events
                tubes.append((engine, result))
        return Outcome(tubes, events, stored, repeated)

    def _note_first(self, known: _Vehicle, states: StateBatch) -> None:
        newest = max(zip(states.epoch.tolist(), (-states.seq.astype(np.int64)).tolist(), strict=True))
        first = (newest[0], -newest[1])
        if (
            known.first is None
            or first[0] > known.first[0]
            or (first[0] == known.first[0] and first[1] < known.first[1])
        ):
            known.first = first

    def _keep(self, vehicle: str, known: _Vehicle, states: StateBatch) -> list[EngineEvent]:
        """Keep the samples of a vehicle without profile, as many as a window may want."""
        known.kept.append(states)
        while len(known.kept) > 1 and sum(len(s.t) for s in known.kept) > KEPT_WITHOUT_PROFILE:
            dropped = known.kept.pop(0)
            for _ in range(len(dropped.t)):
                error = MessageError("no_profile", f"publish the profile of {vehicle} on {keys.profile(vehicle)}")
                self._rejections.count(error, keys.state(vehicle))
        # The profile usually comes with the first samples; it is missing when samples go on without it.
        if "profile" in known.told or sum(len(s.t) for s in known.kept) <= INTERVAL_CHECK:
            return []
        known.told.add("profile")
        message = f"states of {vehicle} come, but no profile: publish it on {keys.profile(vehicle)}"
        return [EngineEvent(EventKind.UNKNOWN_VEHICLE, vehicle, int(states.t[-1]), message)]

    def _accept(
        self,
        vehicle: str,
        known: _Vehicle,
        profile: VehicleProfile,
        states: StateBatch,
        events: list[EngineEvent],
    ) -> SampleBatch | None:
        """The samples as a batch of their class, or None (counted, told once) if they contradict the profile."""
        problem = _contradiction(profile, states)
        if problem is not None:
            for _ in range(len(states.t)):
                self._rejections.count(MessageError("profile", problem), keys.state(vehicle))
            events += self._tell(
                vehicle, known, "shape", int(states.t[-1]), f"samples of {vehicle} are refused: {problem}"
            )
            return None
        low, high = limits(profile)
        known_input = (states.flags & int(StateFlag.INPUT_MISSING) == 0)[:, None]
        beyond = ((states.u < low - 1e-9) | (states.u > high + 1e-9)) & known_input
        if beyond.any():
            name = profile.input_names[int(np.argmax(beyond.any(axis=0)))]
            message = f"input {name} of {vehicle} leaves the limits of its profile: tubes rest on them, widen them"
            events += self._tell(vehicle, known, f"limits {name}", int(states.t[-1]), message)
        if profile.future_inputs == "plan" and states.plan is not None:
            newest = int(np.lexsort((states.seq, states.epoch))[-1])
            key = (int(states.epoch[newest]), int(states.seq[newest]))
            if known.plan is None or key > known.plan.key:
                tolerance = (
                    np.zeros(states.u.shape[1]) if states.plan_tolerance is None else states.plan_tolerance[newest]
                )
                known.plan = _Plan(key, states.plan[newest], tolerance)
        count = len(states.t)
        return SampleBatch(
            np.full(count, known.slot, dtype=np.intp),
            states.epoch,
            states.seq,
            states.t,
            states.flags,
            states.x,
            states.u,
        )

    def _tell(self, vehicle: str, known: _Vehicle, what: str, t: int, message: str) -> list[EngineEvent]:
        if what in known.told:
            return []
        known.told.add(what)
        return [EngineEvent(EventKind.PROFILE_CONTRADICTED, vehicle, t, message)]

    def _check_intervals(self, engine: Engine, slots: NDArray[np.intp]) -> list[EngineEvent]:
        """Tell once about vehicles most of whose sample intervals are not what the profile says."""
        events: list[EngineEvent] = []
        full = slots[engine.window.filled(slots) >= INTERVAL_CHECK]
        if not len(full):
            return events
        block = engine.window.block(full, INTERVAL_CHECK)
        for row in np.flatnonzero(block.linked[:, 1:].mean(axis=1) < 0.5):
            vehicle = engine.vehicles[full[row]]
            typical = float(np.median(np.diff(block.t[row]))) / 1e9
            profile = engine.profile
            if abs(typical - profile.sample_time) <= profile.tolerance * profile.sample_time:
                continue
            message = (
                f"samples of {vehicle} come every {typical:.4g} s, its profile says {profile.sample_time:g} s: "
                "correct sample_time or the source"
            )
            events += self._tell(vehicle, self._vehicles[vehicle], "interval", int(block.t[row, -1]), message)
        return events

    def _by_plan(self, engine: Engine, slots: NDArray[np.intp]) -> list[tuple[NDArray[np.intp], KnownInputs | None]]:
        """Slots with a plan that reaches over the horizon, with it; and the others."""
        if engine.profile.future_inputs != "plan":
            return [(slots, None)]
        needed = engine.horizon - 1
        epoch, seq, _, _ = engine.window.newest(slots)
        newest = zip(epoch.tolist(), seq.tolist(), strict=True)
        # The plan of an older sample does not say what follows the newest one.
        plans = [
            plan if plan is not None and plan.key == key and len(plan.inputs) >= needed else None
            for key, plan in zip(newest, (self._vehicles[engine.vehicles[slot]].plan for slot in slots), strict=True)
        ]
        has = np.array([plan is not None for plan in plans], dtype=bool)
        groups: list[tuple[NDArray[np.intp], KnownInputs | None]] = []
        if has.any():
            chosen = [plan for plan in plans if plan is not None]
            known = KnownInputs(np.stack([p.inputs[:needed] for p in chosen]), np.stack([p.tolerance for p in chosen]))
            groups.append((slots[has], known))
        if not has.all():
            groups.append((slots[~has], None))
        return groups


def _rows(states: StateBatch, rows: NDArray[np.intp]) -> StateBatch:
    def take(array: Floats | None) -> Floats | None:
        return None if array is None else array[rows]

    return StateBatch(
        states.index[rows], states.epoch[rows], states.seq[rows], states.t[rows], states.flags[rows],
        states.x[rows], states.u[rows], take(states.bound), take(states.plan), take(states.plan_tolerance),
    )  # fmt: skip


def _contradiction(profile: VehicleProfile, states: StateBatch) -> str | None:
    """What about some samples of equal layout contradicts the profile, or None."""
    n, m = len(profile.state), len(profile.inputs)
    if states.x.shape[1] != n or states.u.shape[1] != m:
        return f"{states.x.shape[1]} states and {states.u.shape[1]} inputs came, the profile has {n} and {m}"
    if states.bound is not None and profile.noise.measurement is not None:
        stated = np.abs(profile.noise.measurement.matrix()).sum(axis=1)
        if (states.bound > stated * (1 + 1e-9)).any():
            came = states.bound.max(axis=0).tolist()
            return f"a state error of up to {came} came, the profile bounds it by {stated.tolist()}"
    return None
