"""Which samples are let in: those of a vehicle's one writer that fit its profile; others wait, or are counted."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from fleet_bus import keys
from fleet_bus.errors import MessageError
from fleet_bus.messages import EventKind, StateBatch, StateFlag, VehicleProfile
from fleet_bus.rejections import Rejections
from fleet_bus.writers import Change, Source, Turn
from reach_server.data.events import EngineEvent
from reach_server.data.window import SampleBatch
from reach_server.engine.engine import Engine
from reach_server.service import fleet_events
from reach_server.service.profiles import Profiles
from reach_server.service.registry import VehicleRegistry
from reach_server.service.sample_rows import contradiction, input_beyond_limits, newest_plan, samples_of
from reach_server.service.scenario_assignments import ScenarioAssignments
from reach_server.service.vehicle import Vehicle

#: Samples after which the sample interval is held against the profile.
INTERVAL_CHECK: Final = 20
#: Seconds that a profile may take after the first samples before it is missed; under load it comes late.
PROFILE_PATIENCE: Final = 5.0
#: Vehicles without a profile whose samples wait for one, and samples that do, at once.
MOST_UNKNOWN: Final = 1000
MOST_WAITING: Final = 200_000


class SampleAdmission:
    """Decides about samples by who writes the vehicle, what its profile says and how its clock runs."""

    def __init__(
        self,
        registry: VehicleRegistry,
        profiles: Profiles,
        scenarios: ScenarioAssignments,
        rejections: Rejections,
    ) -> None:
        self._registry = registry
        self._profiles = profiles
        self._scenarios = scenarios
        self._rejections = rejections
        #: Vehicles that something is decided about by the passing of time.
        self._rivalled: set[str] = set()
        #: Vehicles of which two sources write the states, and what their tubes say.
        self.conflicts: dict[str, str] = {}
        #: Samples that wait for a profile, by vehicle.
        self._waiting: dict[str, int] = {}

    def forget(self, vehicle: str) -> None:
        """A vehicle is not known any more."""
        self._rivalled.discard(vehicle)
        self.conflicts.pop(vehicle, None)
        self._waiting.pop(vehicle, None)

    def elapse(self, now: float) -> list[EngineEvent]:
        """What happens because time has passed: whose turn it is to write, and whose profile is missed."""
        events: list[EngineEvent] = []
        for vehicle in sorted(self._rivalled):
            known = self._registry.vehicles[vehicle]
            before, rival = known.writer.source, known.writer.rival
            change = known.writer.elapse(now, known.patience, known.leave)
            events += self._changed(vehicle, known, change, before, rival)
        for vehicle in self._waiting:
            events += self._miss_profile(vehicle, self._registry.vehicles[vehicle], now)
        return events

    def refuse(self, reason: str, detail: str, vehicle: str, number: int) -> None:
        """Count samples of a vehicle that are not let in."""
        if number:
            self._rejections.count(MessageError(reason, detail), keys.state(vehicle), number)

    def admit(
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
            self.refuse("other_source", "two other sources write to it already", vehicle, len(states.t))
            return []
        if turn is Turn.HOLD:
            dropped = known.hold(states)
            self.refuse("other_source", f"{source} writes beside {before}", vehicle, dropped)
            return []
        events += self._changed(vehicle, known, change, before, rival or source)
        if before is None:
            events += self._profiles.begin(vehicle, known, source)
        known.heard = known.seen = now
        known.gone = False
        known.note_first(states)
        if arrived is not None:
            events += self._see_clock(vehicle, known, states, arrived, now)
        if known.foreign is not None:
            self._profiles.tell_foreign(vehicle, known, len(states.t), int(states.t[-1]), events)
        profile = known.served
        if profile is None:
            events += self._keep(vehicle, known, states, now)
            return []
        if known.engine is None:
            self._registry.enter(vehicle, known, profile)
            events += self._scenarios.apply_to(vehicle)
        kept, known.kept = known.kept, []
        self._waiting.pop(vehicle, None)
        accepted = [self._accept(vehicle, known, profile, part, events) for part in (*kept, states)]
        return [part for part in accepted if part is not None]

    def _changed(
        self, vehicle: str, known: Vehicle, change: Change, before: Source | None, other: Source | None
    ) -> list[EngineEvent]:
        """What follows from a change of who writes the states of a vehicle."""
        if change is Change.NONE or before is None or other is None:
            return []
        if change is Change.CONFLICT:
            self.conflicts[vehicle] = "two sources publish this vehicle"
            return [fleet_events.two_sources(vehicle, self._registry.stamp, before, other)]
        self._rivalled.discard(vehicle)
        self.conflicts.pop(vehicle, None)
        events: list[EngineEvent] = []
        if change in (Change.STAYED, Change.DISMISSED):
            self.refuse("other_source", f"{other} wrote beside {before}, which goes on", vehicle, known.drop_held())
        else:
            known.follow()
            events += self._profiles.begin(vehicle, known, other)
            # Samples of two sources that drove at the same time, or of a clock that was set back, are not one drive.
            if known.engine is not None and (change is Change.LOST or other.epoch < before.epoch):
                known.engine.reset(vehicle)
        if change in (Change.STAYED, Change.LOST):
            left = before if change is Change.STAYED else other
            events.append(fleet_events.one_source(vehicle, self._registry.stamp, left))
        return events

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
            self._registry.clocks_off[vehicle] = f"clock off by {offset:+.3g} s"
        else:
            self._registry.clocks_off.pop(vehicle, None)
        told = fleet_events.clock(vehicle, int(states.t[-1]), offset, off=off)
        return [told, *self._scenarios.apply_to(vehicle)]

    def _keep(self, vehicle: str, known: Vehicle, states: StateBatch, now: float) -> list[EngineEvent]:
        """Keep the samples of a vehicle without profile, as many as a window may want."""
        waiting = self._waiting.get(vehicle, 0)
        crowded = not waiting and len(self._waiting) >= MOST_UNKNOWN
        if crowded or sum(self._waiting.values()) + len(states.t) > MOST_WAITING:
            self.refuse("no_profile", "too many samples wait for profiles", vehicle, len(states.t))
            return []
        dropped = known.keep(states, now)
        self._waiting[vehicle] = waiting + len(states.t) - dropped
        self.refuse("no_profile", f"publish the profile of {vehicle} on {keys.profile(vehicle)}", vehicle, dropped)
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

    def check_intervals(self, engine: Engine, slots: NDArray[np.intp]) -> list[EngineEvent]:
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
            known = self._registry.vehicles[vehicle]
            if "interval" not in known.told:
                known.told.add("interval")
                events.append(fleet_events.wrong_interval(vehicle, int(block.t[row, -1]), typical, profile.sample_time))
        return events
