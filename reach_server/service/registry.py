"""The fleet as a server sees it: which vehicle belongs to which class, and one engine per class.

No network and no clock in here: messages, and the times at which they came, in; tubes and events out.
"""

from collections import defaultdict
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Final

import numpy as np
import structlog
from numpy.typing import NDArray

from fleet_bus import keys
from fleet_bus.errors import MessageError, ScenarioError, UsageError
from fleet_bus.messages import Assignment, EventKind, ScenarioDocument, StateBatch, StateFlag, VehicleProfile
from fleet_bus.rejections import Rejections
from fleet_bus.writers import EVIDENCE, Change, Source, Turn
from reach_server.data.events import EngineEvent
from reach_server.data.window import SampleBatch
from reach_server.engine.engine import Engine, PlannedInputs
from reach_server.engine.results import Tubes
from reach_server.service import fleet_events
from reach_server.service.admission import by_plan, contradiction, input_beyond_limits, newest_plan, rows_of, samples_of
from reach_server.service.ingest import VehicleBatch
from reach_server.service.scenario_book import ScenarioBook
from reach_server.service.vehicle import Vehicle
from side_info import Scenario

_log = structlog.get_logger(__name__)

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
#: Samples after which the sample interval is held against the profile.
INTERVAL_CHECK: Final = 20
#: Seconds that a profile may take after the first samples before it is missed; under load it comes late.
PROFILE_PATIENCE: Final = 5.0
#: Seconds of silence after which a vehicle may be let go, and after which it is; and how many silent ones are kept.
SILENT: Final = 30.0
LET_GO: Final = 600.0
LEAST_SILENT_KEPT: Final = 16
#: Vehicles that are known at once, those without a profile among them, and samples that wait for profiles at once.
MOST_VEHICLES: Final = 20_000
MOST_UNKNOWN: Final = 1000
MOST_WAITING: Final = 200_000


@dataclass(frozen=True, slots=True)
class Outcome:
    """What one round of samples led to."""

    tubes: list[tuple[Engine, Tubes]]
    events: list[EngineEvent]
    stored: int
    repeated: int


class Fleet:
    """Vehicles, their classes, the scenarios and who takes part in them.

    ``stamp`` tells the time of events that no sample tells (ns since the Unix epoch). ``source`` names the session that
    sent a message, ``now`` (s) is when it came, by any clock that never goes back; without it the newest stamp tells
    the time.
    """

    def __init__(self, rejections: Rejections, stamp: Callable[[], int] | None = None) -> None:
        self._rejections = rejections
        self._tell_time = stamp
        self._vehicles: dict[str, Vehicle] = {}
        self._engines: dict[tuple[object, ...], Engine] = {}
        self._book = ScenarioBook()
        self._now = 0.0
        #: Vehicles that something is decided about by the passing of time.
        self._rivalled: set[str] = set()
        #: Vehicles of which two sources write the states, and what their tubes say.
        self._conflicts: dict[str, str] = {}
        self._clocks_off: dict[str, str] = {}
        #: Samples that wait for a profile, by vehicle.
        self._waiting: dict[str, int] = {}

    @property
    def engines(self) -> tuple[Engine, ...]:
        """One engine per vehicle class."""
        return tuple(self._engines.values())

    @property
    def vehicles(self) -> tuple[str, ...]:
        """Ids of the vehicles that are known."""
        return tuple(self._vehicles)

    def profile_of(self, vehicle: str) -> VehicleProfile | None:
        """Profile of a vehicle, if it has come."""
        known = self._vehicles.get(vehicle)
        return None if known is None else known.profile

    def heard(self, vehicle: str) -> float | None:
        """When the newest sample of a vehicle came (s), if one did."""
        known = self._vehicles.get(vehicle)
        return None if known is None or known.heard == -float("inf") else known.heard

    def interval(self, vehicle: str) -> float:
        """Sample time of a vehicle (s), 0 where it is not known."""
        profile = self.profile_of(vehicle)
        return 0.0 if profile is None else profile.sample_time

    def waits_for_profile(self, vehicle: str) -> bool:
        """Whether samples of a vehicle wait for a profile."""
        known = self._vehicles.get(vehicle)
        return known is not None and bool(known.kept) and known.served is None

    def scenario_source(self, name: str) -> str:
        """Session of the service that publishes a scenario, empty where nobody does."""
        return self._book.source(name)

    def clock_offsets(self) -> dict[str, tuple[float, float]]:
        """By vehicle, by how much its clock is ahead of the server's at least, and the spread of that (s)."""
        return {
            vehicle: (known.clock.offset, known.clock.spread)
            for vehicle, known in self._vehicles.items()
            if known.clock.known
        }

    def window_keys(self, vehicle: str) -> list[tuple[int, int]]:
        """(epoch, seq) of the samples in a vehicle's window."""
        known = self._vehicles.get(vehicle)
        return [] if known is None or known.engine is None else known.engine.window.keys(known.slot)

    def first_sample(self, vehicle: str) -> tuple[int, int] | None:
        """(epoch, seq) of the first sample seen of the newest epoch of a vehicle."""
        known = self._vehicles.get(vehicle)
        return None if known is None else known.first

    def set_profile(
        self, vehicle: str, profile: VehicleProfile, source: str = "", now: float | None = None
    ) -> list[EngineEvent]:
        """Take over a profile. Another one than before moves the vehicle to another class, with an empty window.

        That of another session than the one that writes the vehicle's states is kept for the case that this session
        comes to write them. Raises ``MessageError`` for one that no engine can work with, and where another session's
        is in force.
        """
        known = self._known(vehicle)
        if known is None:
            raise MessageError("overflow", f"{MOST_VEHICLES} vehicles are known already")
        known.seen, known.gone = self._time(now), False
        if known.profile != profile:
            self._check_usable(profile)
        known.offer(source, profile)
        if known.writes(source):
            return self._adopt(vehicle, known, profile, source)
        if known.writer.there(self._time(now), known.leave):
            # An agent that follows another sends its profile first: whether this is one shows by who goes on.
            known.foreign = source, 0
        elif known.writer.source is None:
            raise MessageError("other_source", f"another session has published the profile of {vehicle}: it counts")
        return []

    def set_scenario(self, document: ScenarioDocument, source: str = "", now: float | None = None) -> list[EngineEvent]:
        """Take over a scenario; raise ``MessageError`` if its document is not to be taken."""
        scenario = self._book.put_document(document, source, self._time(now))
        return [] if scenario is None else self._apply_all(self._book.of_scenario(scenario.name))

    def assign(self, assignment: Assignment, source: str = "", now: float | None = None) -> list[EngineEvent]:
        """Take over an assignment; it acts as soon as scenario and profile are there. Raises ``MessageError`` for one
        that does not come from the service that publishes the scenario."""
        self._book.put_assignment(assignment, source, self._time(now))
        return self._apply(assignment)

    def hear_service(self, source: str, now: float) -> None:
        """A side-info service was heard."""
        self._book.hear(source, now)

    def elapse(self, now: float) -> list[EngineEvent]:
        """What happens because time has passed: whose turn it is to write, and which scenarios come into force."""
        self._time(now)
        events: list[EngineEvent] = []
        for vehicle in sorted(self._rivalled):
            known = self._vehicles[vehicle]
            before, rival = known.writer.source, known.writer.rival
            change = known.writer.elapse(now, known.patience, known.leave)
            events += self._changed(vehicle, known, change, before, rival)
        for vehicle in self._waiting:
            events += self._miss_profile(vehicle, self._vehicles[vehicle], now)
        for followed in self._book.elapse(now):
            others = () if followed.scenario is None else self._book.of_scenario(followed.scenario.name)
            events += self._apply_all({(a.scenario, a.vehicle): a for a in (*others, *followed.assignments)}.values())
        for contest in self._book.contested():
            events += [
                fleet_events.contested_scenario(assignment.vehicle, self._stamp, contest)
                for assignment in self._book.of_scenario(contest.scenario)
                if assignment.vehicle in self._vehicles
            ]
        return events

    def mark_gone(self, vehicle: str) -> None:
        """A vehicle is certainly gone: it need not have been silent for ``SILENT`` seconds to be let go."""
        if (known := self._vehicles.get(vehicle)) is not None:
            known.gone = True

    def let_go(self, now: float) -> list[str]:
        """Forget vehicles that have been silent for long, or that more than enough are silent beside; their ids."""
        silent = sorted(
            (known.seen, vehicle)
            for vehicle, known in self._vehicles.items()
            if known.gone or now - known.seen > SILENT
        )
        live = len(self._vehicles) - len(silent)
        # While nobody is heard it is the network that is silent.
        most = max(LEAST_SILENT_KEPT, live // 4) if live else len(silent)
        surplus = max(len(silent) - most, 0)
        gone = [vehicle for place, (seen, vehicle) in enumerate(silent) if place < surplus or now - seen > LET_GO]
        for vehicle in gone:
            self._forget(vehicle)
        return gone

    def _forget(self, vehicle: str) -> None:
        known = self._vehicles.pop(vehicle)
        self._rivalled.discard(vehicle)
        self._conflicts.pop(vehicle, None)
        self._clocks_off.pop(vehicle, None)
        self._waiting.pop(vehicle, None)
        self._book.forget(vehicle)
        if known.engine is not None:
            self._leave(vehicle, known.engine)

    def process(self, batches: list[VehicleBatch], now: float | None = None) -> Outcome:
        """Store all samples and compute a tube from the newest one of each vehicle that got any."""
        stamps = [int(batch.states.t.max()) for batch in batches if len(batch.states.t)]
        now = self._time(max(stamps, default=0) / 1e9 if now is None else now)
        events: list[EngineEvent] = []
        parts: defaultdict[int, list[SampleBatch]] = defaultdict(list)
        for batch in batches:
            for (vehicle, session, epoch), rows in batch.by_writer().items():
                known = self._known(vehicle)
                if known is None:
                    self._refuse("overflow", f"{MOST_VEHICLES} vehicles are known already", vehicle, len(rows))
                    continue
                every = len(rows) == len(batch.vehicles)
                states = batch.states if every else rows_of(batch.states, np.array(rows))
                arrived = None if batch.arrived_ns is None else batch.arrived_ns[rows]
                for part in self._admit(vehicle, known, states, Source(session, epoch), arrived, now, events):
                    parts[id(known.engine)].append(part)
        engines = {id(engine): engine for engine in self._engines.values()}
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
            for field, reason, detail in SETTLED:
                if number := getattr(appended, field):
                    self._rejections.count(MessageError(reason, detail), "fleet/*/state", number)
            events += self._check_intervals(engine, slots)
            events += found
            after = engine.window.newest(slots)
            # What an agent's cache repeats fills the window, it is no reason for another tube.
            slots = slots[(before[0] != after[0]) | (before[1] != after[1]) | (before[2] != after[2])]
            for group, known_inputs in self._by_plan(engine, slots) if len(slots) else []:
                result = engine.predict(group, known_inputs)
                events += result.events
                tubes.append((engine, result.noted(self._clocks_off).noted(self._conflicts, contradicted=True)))
        return Outcome(tubes, events, stored, repeated)

    @property
    def _stamp(self) -> int:
        """The time of now as a stamp (ns)."""
        return max(1, int(self._now * 1e9)) if self._tell_time is None else self._tell_time()

    def _time(self, now: float | None) -> float:
        if now is not None:
            self._now = max(self._now, now)
        return self._now

    def _refuse(self, reason: str, detail: str, vehicle: str, number: int) -> None:
        if number:
            self._rejections.count(MessageError(reason, detail), keys.state(vehicle), number)

    def _known(self, vehicle: str) -> Vehicle | None:
        known = self._vehicles.get(vehicle)
        if known is None and len(self._vehicles) < MOST_VEHICLES:
            known = self._vehicles[vehicle] = Vehicle()
        return known

    def _check_usable(self, profile: VehicleProfile) -> None:
        if profile.shape_key() in self._engines:
            return
        try:
            Engine(profile)
        # Whatever it is about a profile that no engine can be made for: the one before, if there is one, stays.
        except UsageError as error:
            raise MessageError("fields", str(error)) from None
        except Exception as error:
            _log.exception("no engine for a profile")
            raise MessageError("fields", f"no engine can work with it: {type(error).__name__}: {error}") from None

    def _adopt(self, vehicle: str, known: Vehicle, profile: VehicleProfile, source: str) -> list[EngineEvent]:
        """Put a profile that is usable in force."""
        before, known.profile_source, known.awaits_profile = known.profile, source, False
        if before == profile:
            return []
        known.profile, known.told, known.plan = profile, set(), None
        left, known.engine = known.engine, None
        if left is not None:
            self._enter(vehicle, known, profile)
            self._leave(vehicle, left)
        events = self._apply_all(self._book.of_vehicle(vehicle))
        if before is not None:
            events.append(fleet_events.profile_changed(vehicle, self._stamp, before, profile))
        return events

    def _enter(self, vehicle: str, known: Vehicle, profile: VehicleProfile) -> None:
        """Give a vehicle a slot of its class."""
        key = profile.shape_key()
        engine = self._engines.get(key)
        if engine is None:
            engine = self._engines[key] = Engine(profile)
        known.engine, known.slot = engine, engine.add(vehicle)

    def _leave(self, vehicle: str, engine: Engine) -> None:
        engine.remove(vehicle)
        if not engine.count:
            self._engines = {key: other for key, other in self._engines.items() if other is not engine}

    def _apply_all(self, assignments: Iterable[Assignment]) -> list[EngineEvent]:
        return [event for assignment in list(assignments) for event in self._apply(assignment)]

    def _apply(self, assignment: Assignment) -> list[EngineEvent]:
        """Let an assignment act on its vehicle; what is wrong with it is told, and stops nobody else's."""
        known = self._vehicles.get(assignment.vehicle)
        scenario = self._book.scenario(assignment.scenario)
        if known is None or known.profile is None or scenario is None:
            return []
        try:
            if known.engine is None:
                scenario.state_indices(known.profile)
            elif not assignment.active or self._suspended(assignment.vehicle, scenario):
                known.engine.unassign(assignment.vehicle, scenario.name)
            else:
                known.engine.assign(assignment.vehicle, scenario, assignment.time_zero, assignment.clock_offset)
        except Exception as error:
            # What was in force before is withdrawn: a scenario that cannot be followed must not cut.
            if known.engine is not None:
                known.engine.unassign(assignment.vehicle, scenario.name)
            if not isinstance(error, ScenarioError):
                _log.exception("an assignment failed", vehicle=assignment.vehicle, scenario=scenario.name)
            message = str(error) if isinstance(error, ScenarioError) else f"{type(error).__name__}: {error}"
            return [EngineEvent(EventKind.SCENARIO_REFUSED, assignment.vehicle, assignment.time_zero, message)]
        return []

    def _suspended(self, vehicle: str, scenario: Scenario) -> bool:
        """Whether a scenario speaks about a time of day that the vehicle's clock does not tell."""
        return scenario.time_zero is not None and vehicle in self._clocks_off

    def _admit(
        self,
        vehicle: str,
        known: Vehicle,
        states: StateBatch,
        source: Source,
        arrived: NDArray[np.int64] | None,
        now: float,
        events: list[EngineEvent],
    ) -> list[SampleBatch]:
        """Samples of one source as batches of their class; held, kept, or refused (counted) where they are not to be
        used now."""
        before, rival = known.writer.source, known.writer.rival
        turn, change = known.writer.judge(source, len(states.t), now, known.patience, known.leave)
        if known.writer.rival is not None:
            self._rivalled.add(vehicle)
        if turn is Turn.REFUSE:
            self._refuse("other_source", "two other sources write to it already", vehicle, len(states.t))
            return []
        if turn is Turn.HOLD:
            dropped = known.hold(states)
            self._refuse("other_source", f"{source} writes beside {before}", vehicle, dropped)
            return []
        events += self._changed(vehicle, known, change, before, rival or source)
        if before is None:
            events += self._begin(vehicle, known, source)
        known.heard = known.seen = now
        known.gone = False
        known.note_first(states)
        if arrived is not None:
            events += self._see_clock(vehicle, known, states, arrived, now)
        if known.foreign is not None:
            self._tell_foreign_profile(vehicle, known, len(states.t), int(states.t[-1]), events)
        profile = known.served
        if profile is None:
            events += self._keep(vehicle, known, states, now)
            return []
        if known.engine is None:
            self._enter(vehicle, known, profile)
            events += self._apply_all(self._book.of_vehicle(vehicle))
        kept, known.kept = known.kept, []
        self._waiting.pop(vehicle, None)
        accepted = [self._accept(vehicle, known, profile, part, events) for part in (*kept, states)]
        return [part for part in accepted if part is not None]

    def _begin(self, vehicle: str, known: Vehicle, source: Source) -> list[EngineEvent]:
        """The first source of a vehicle, or another one, writes its states: its profile counts from now on."""
        if known.profile is None or not source.session or source.session == known.profile_source:
            return []
        offered = known.offered.get(source.session)
        if offered is None:
            known.awaits_profile = True
            return []
        return self._adopt(vehicle, known, offered, source.session)

    def _changed(
        self, vehicle: str, known: Vehicle, change: Change, before: Source | None, other: Source | None
    ) -> list[EngineEvent]:
        """What follows from a change of who writes the states of a vehicle."""
        if change is Change.NONE or before is None or other is None:
            return []
        if change is Change.CONFLICT:
            self._conflicts[vehicle] = "two sources publish this vehicle"
            return [fleet_events.two_sources(vehicle, self._stamp, before, other)]
        self._rivalled.discard(vehicle)
        self._conflicts.pop(vehicle, None)
        events: list[EngineEvent] = []
        if change in (Change.STAYED, Change.DISMISSED):
            self._refuse("other_source", f"{other} wrote beside {before}, which goes on", vehicle, known.drop_held())
        else:
            known.follow()
            events += self._begin(vehicle, known, other)
            # Samples of two sources that drove at the same time, or of a clock that was set back, are not one drive.
            if known.engine is not None and (change is Change.LOST or other.epoch < before.epoch):
                known.engine.reset(vehicle)
        if change in (Change.STAYED, Change.LOST):
            left = before if change is Change.STAYED else other
            events.append(fleet_events.one_source(vehicle, self._stamp, left))
        return events

    def _tell_foreign_profile(
        self, vehicle: str, known: Vehicle, count: int, t: int, events: list[EngineEvent]
    ) -> None:
        session, since = known.foreign or ("", 0)
        if since + count < EVIDENCE:
            known.foreign = session, since + count
            return
        known.foreign = None
        detail = f"{Source(session)} publishes a profile of {vehicle}, whose states {known.writer.source} publishes"
        self._rejections.count(MessageError("other_source", detail), keys.profile(vehicle))
        if f"profile of {session}" not in known.told:
            known.told.add(f"profile of {session}")
            events.append(EngineEvent(EventKind.PROFILE_REFUSED, vehicle, t, f"profile refused: {detail}"))

    def _see_clock(
        self, vehicle: str, known: Vehicle, states: StateBatch, arrived: NDArray[np.int64], now: float
    ) -> list[EngineEvent]:
        """Hold the stamps of live samples against the times at which they came."""
        live = states.flags & int(StateFlag.HISTORY) == 0
        if not live.any():
            return []
        known.clock.see(float((states.t - arrived)[live].max()) / 1e9, now)
        if not known.clock.crossed():
            return []
        offset, off = known.clock.offset, known.clock.off
        if off:
            self._clocks_off[vehicle] = f"clock off by {offset:+.3g} s"
        else:
            self._clocks_off.pop(vehicle, None)
        told = fleet_events.clock(vehicle, int(states.t[-1]), offset, off=off)
        return [told, *self._apply_all(self._book.of_vehicle(vehicle))]

    def _keep(self, vehicle: str, known: Vehicle, states: StateBatch, now: float) -> list[EngineEvent]:
        """Keep the samples of a vehicle without profile, as many as a window may want."""
        waiting = self._waiting.get(vehicle, 0)
        crowded = not waiting and len(self._waiting) >= MOST_UNKNOWN
        if crowded or sum(self._waiting.values()) + len(states.t) > MOST_WAITING:
            self._refuse("no_profile", "too many samples wait for profiles", vehicle, len(states.t))
            return []
        dropped = known.keep(states, now)
        self._waiting[vehicle] = waiting + len(states.t) - dropped
        self._refuse("no_profile", f"publish the profile of {vehicle} on {keys.profile(vehicle)}", vehicle, dropped)
        return self._miss_profile(vehicle, known, now)

    def _miss_profile(self, vehicle: str, known: Vehicle, now: float) -> list[EngineEvent]:
        """Tell once of a profile that has not come: usually it comes with the first samples, under load later."""
        late = now - known.kept_since > PROFILE_PATIENCE and self._waiting[vehicle] > INTERVAL_CHECK
        if "profile" in known.told or not late:
            return []
        known.told.add("profile")
        writer = None if known.profile is None else known.writer.source
        return [fleet_events.profile_missing(vehicle, int(known.kept[-1].t[-1]), writer)]

    def _accept(
        self, vehicle: str, known: Vehicle, profile: VehicleProfile, states: StateBatch, events: list[EngineEvent]
    ) -> SampleBatch | None:
        """The samples as a batch of their class, or None (counted, told once) if they contradict the profile."""
        problem = contradiction(profile, states)
        if problem is not None:
            self._rejections.count(MessageError("profile", problem), keys.state(vehicle), len(states.t))
            events += self._tell(
                vehicle, known, "shape", int(states.t[-1]), f"samples of {vehicle} are refused: {problem}"
            )
            return None
        beyond = input_beyond_limits(profile, states)
        if beyond is not None:
            message = f"input {beyond} of {vehicle} leaves the limits of its profile: tubes rest on them, widen them"
            events += self._tell(vehicle, known, f"limits {beyond}", int(states.t[-1]), message)
        if profile.future_inputs == "plan":
            plan = newest_plan(states)
            if plan is not None and (known.plan is None or plan.key > known.plan.key):
                known.plan = plan
        return samples_of(states, known.slot)

    def _tell(self, vehicle: str, known: Vehicle, what: str, t: int, message: str) -> list[EngineEvent]:
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
            known = self._vehicles[vehicle]
            if "interval" not in known.told:
                known.told.add("interval")
                events.append(fleet_events.wrong_interval(vehicle, int(block.t[row, -1]), typical, profile.sample_time))
        return events

    def _by_plan(self, engine: Engine, slots: NDArray[np.intp]) -> list[tuple[NDArray[np.intp], PlannedInputs | None]]:
        if engine.profile.future_inputs != "plan":
            return [(slots, None)]
        epoch, seq, _, _ = engine.window.newest(slots)
        newest = list(zip(epoch.tolist(), seq.tolist(), strict=True))
        plans = [self._vehicles[engine.vehicles[slot]].plan for slot in slots]
        return by_plan(slots, newest, plans, engine.horizon - 1)
