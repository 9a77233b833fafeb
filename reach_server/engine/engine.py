"""The vehicles of one class: their slots, samples, scenarios and audit, and a step for a batch of them. No clock."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fleet_bus.messages import Audit, EventKind, StateFlag, VehicleProfile
from reach_server.audit.coverage import CoverageRecord
from reach_server.audit.labels import Labels
from reach_server.data import ring_buffer as ring
from reach_server.data.events import EngineEvent
from reach_server.data.readiness import too_few
from reach_server.data.window import AppendReport, Block, SampleBatch, Window
from reach_server.engine import notices
from reach_server.engine.results import Checks, Tubes
from reach_server.engine.tube_builder import TubeBuilder
from reach_server.methods import method_of
from reach_server.methods.request import PlannedInputs, TubeRequest
from reach_server.numeric.types import FloatArray, IndexArray
from reach_server.predicates.cut_kinds import CUT_KINDS
from reach_server.sets import support
from reach_server.side_information.scenarios import Assignments
from side_info import Scenario

__all__ = ["Engine", "PlannedInputs"]


def unheeded(stage: str) -> None:
    """Nobody times the stages."""


class Engine:
    """Reachable sets of the vehicles of one class: windows, models, tubes and audit, arrays in, arrays out.

    What a set claims is the label of its tube: outer where ``guaranteed``, a rate where ``calibrated``, else nothing.
    All times are ns since the Unix epoch, all states and inputs in the units of the profile. Not for several threads.

    Args:
        profile: the class.
        method: overrides the profile's method; ``default`` is ``set_membership`` where every bound is given, else
            ``calibrated``; ``paper`` is ``residual_hull`` in the world frame.
        horizon: overrides the profile's.
        planned: later inputs will be given to ``step``, so that the calibrated model uses them; by default where the
            profile says ``future_inputs: plan``.

    Raises ``UsageError`` for a profile that the method cannot work with.
    """

    def __init__(
        self,
        profile: VehicleProfile,
        *,
        method: str | None = None,
        horizon: int | None = None,
        planned: bool | None = None,
    ) -> None:
        self.profile = profile
        if planned is None:
            planned = profile.future_inputs == "plan"
        self.horizon = horizon or profile.horizon
        self.window = Window(profile)
        self.method, self._method, claim = method_of(method, profile, self.window, self.horizon, planned=planned)
        if CUT_KINDS[profile.cuts].adds_constraints:
            # Compiles on the first run after an installation, better here than in the middle of a round.
            support.warm_up()
        self._slots: dict[str, int] = {}
        self._names: list[str] = []
        #: Slots of vehicles that were removed.
        self._free: list[int] = []
        self._assignments = self._new_assignments()
        self._labels = Labels(profile, claim, self._method.lipschitz, self._method.notes)
        self._record = CoverageRecord(0.0 if self._labels.certain else 1.0 - profile.confidence, self.window.size)
        self._leaps = notices.Leaps()
        self._builder = TubeBuilder(
            profile, self.horizon, self.method, self._method,
            names=self._names, assignments=self._assignments, labels=self._labels, record=self._record,
        )  # fmt: skip

    def _new_assignments(self) -> Assignments:
        received = self._method.bounds.measurement
        if not self._method.claims_measured:
            return Assignments(self.profile, self._nothing, received, self.horizon)
        known = received if self.profile.noise.measurement is not None else None
        return Assignments(self.profile, known, known, self.horizon)

    @property
    def _nothing(self) -> FloatArray:
        return np.zeros((len(self.profile.state), 0))

    @property
    def vehicles(self) -> tuple[str, ...]:
        """Ids of the vehicles, by slot; empty for a slot whose vehicle was removed."""
        return tuple(self._names)

    @property
    def noise_of_claim(self) -> FloatArray:
        """Generators (n, g) by which a measured state may lie outside of a true set; none for calibrated sets, which
        speak about measured states."""
        return self._nothing if self._method.claims_measured else self._method.bounds.measurement

    @property
    def frozen(self) -> bool:
        """Whether nothing is learned any more: predictions rest on what had come when this was set."""
        return self._method.frozen

    @frozen.setter
    def frozen(self, value: bool) -> None:
        self._method.learn(np.arange(len(self._names)))
        self._method.frozen = value

    def add(self, vehicle: str) -> int:
        """Slot of a vehicle, made if it is new."""
        slot = self._slots.get(vehicle)
        if slot is None and self._free:
            slot = self._slots[vehicle] = self._free.pop()
            self._names[slot] = vehicle
        elif slot is None:
            slot = self._slots[vehicle] = len(self._names)
            self._names.append(vehicle)
            self.window.grow(slot + 1)
            self._method.grow(slot + 1)
            self._record.grow(slot + 1)
        return slot

    def remove(self, vehicle: str) -> None:
        """Forget a vehicle altogether; its slot goes to the next new one. Raises ``KeyError`` for one that was never
        added."""
        self.reset(vehicle)
        slot = self._slots.pop(vehicle)
        self._assignments.drop(slot)
        self._names[slot] = ""
        self._free.append(slot)

    @property
    def count(self) -> int:
        """Number of vehicles."""
        return len(self._slots)

    def reset(self, vehicle: str) -> None:
        """Forget samples, model and record of a vehicle; its slot and its scenarios stay. Raises ``KeyError`` for one
        that was never added."""
        slot = self._slots[vehicle]
        self.window.clear(slot)
        self._method.reset(slot)
        self._record.reset(slot)
        self._builder.forget(slot)
        self._leaps.forget(slot)

    def assign(self, vehicle: str, scenario: Scenario, time_zero: int, clock_offset: float = 0.0) -> None:
        """Cut the tubes of a vehicle by a scenario from now on.

        ``time_zero`` is in ns since the Unix epoch, ``clock_offset`` (s) bounds how far the two clocks differ. Raises
        ``ScenarioError`` if the states of the scenario do not fit those of the profile.
        """
        for slot in self._assignments.assign(self.add(vehicle), scenario, time_zero, clock_offset):
            # What another scenario has cut must not be held against this one.
            self._record.predictions.drop(slot)

    def unassign(self, vehicle: str, scenario: str) -> None:
        """Stop cutting the tubes of a vehicle by a scenario."""
        slot = self.add(vehicle)
        self._assignments.unassign(slot, scenario)
        self._record.predictions.drop(slot)

    def audit_of(self, vehicle: str) -> Audit:
        """One-step predictions of a vehicle that were checked, and how many held. Raises ``KeyError`` for one that was
        never added."""
        return self._record.audit(self._slots[vehicle])

    @property
    def checks(self) -> Checks:
        """One-step predictions checked since the class was made, of vehicles that have left it, too."""
        record = self._record
        return Checks(record.checked_so_far, record.inside_so_far, record.alpha * record.checked_so_far)

    def window_filled(self) -> NDArray[np.int64]:
        """Samples held (V,) of the vehicles, by slot."""
        return self.window.filled(np.array(sorted(self._slots.values()), dtype=np.intp))

    def append(self, batch: SampleBatch) -> tuple[AppendReport, tuple[EngineEvent, ...]]:
        """Store samples without computing tubes; checks the predictions that waited for them."""
        appended = self.window.append(batch)
        events = self._check(batch, appended)
        stored = appended.stored_rows
        recorded = batch.flags & int(StateFlag.HISTORY) != 0
        begins = stored & ~recorded & ((batch.flags & int(StateFlag.NEW_TRAJECTORY) != 0) | (batch.seq == 0))
        for slot in np.unique(batch.vehicle[appended.rows(ring.RESYNCED)]).tolist():
            # Of what began with a number that was wrong, what follows is not the continuation.
            self._assignments.forget_beginning(slot)
        if begins.any():
            order = list(zip(batch.epoch[begins].tolist(), batch.seq[begins].tolist(), strict=True))
            self._assignments.began(batch.vehicle[begins], batch.t[begins], order)
        events += self._leaps.of(batch, appended, self._names, self.window)
        events += notices.jumps(batch, appended, self._names, self._record)
        return appended, tuple(events)

    def step(self, batch: SampleBatch, known: PlannedInputs | None = None) -> Tubes:
        """Store samples and return the tubes from the newest sample of each vehicle in the batch.

        ``known`` has one row per vehicle, in ascending order of slots. Vehicles without a tube are in ``waiting``, with
        the reason.
        """
        _, events = self.append(batch)
        tubes = self.predict(np.unique(batch.vehicle), known)
        return replace(tubes, events=events + tubes.events)

    def predict(
        self, slots: IndexArray, known: PlannedInputs | None = None, passed: Callable[[str], object] = unheeded
    ) -> Tubes:
        """Tubes from the newest samples of the vehicles in ``slots`` (B,), ascending; ``known`` has one row per slot.

        ``passed`` is told when a stage is over, so that who has a clock can time it: ``side_information``, ``learn``,
        ``sets``.
        """
        events = self._receive(slots)
        passed("side_information")
        if not self.frozen:
            self._method.learn(slots)
        passed("learn")
        events += [
            EngineEvent(EventKind.GLITCH, self._names[slot], t, f"a measurement of {self._names[slot]} was a glitch")
            for slot, t in self._method.glitches()
        ]
        served, limited, waiting = self._serve(slots, known)
        parts: list[Tubes] = []
        if len(served.slots):
            parts.append(self._builder.tubes(served, events, waiting))
        if len(limited.slots):
            parts.append(self._builder.tubes_from_limits(limited, waiting))
        passed("sets")
        found = [part for part in parts if part.vehicles]
        if not found:
            return replace(self._builder.no_tubes(waiting), events=tuple(events))
        return replace(found[0] if len(found) == 1 else Tubes.together(found), events=tuple(events), waiting=waiting)

    def _receive(self, slots: IndexArray) -> list[EngineEvent]:
        """Let the scenarios see what has been measured of some vehicles."""
        held = slots[self.window.filled(slots) > 0]
        if not len(held):
            return []
        newest = self.window.newest(held)[2]

        def block(wanted: IndexArray, length: int) -> Block:
            samples = self.window.block(wanted, min(length, self.window.size - 1))
            # What was recorded before the vehicle started is no part of what scenarios speak about, and a pose that
            # jumped there and back, or has only just jumped, says nothing about them.
            length = samples.t.shape[1]
            counts = ~(self.window.recorded(wanted, length) | self.window.stray(wanted, length))
            return replace(samples, valid=samples.valid & counts)

        events = self._assignments.receive(held, self._names, newest, block)
        # What lay outside of a set only because of side information, and no predicate explains.
        for slot in sorted(self._record.unexplained.keys() & set(held.tolist())):
            t = self._record.unexplained.pop(slot)
            if not any(event.vehicle == self._names[slot] for event in events):
                events += self._assignments.contradict(slot, self._names[slot], t, None)
        return events

    def _serve(self, slots: IndexArray, known: PlannedInputs | None) -> tuple[TubeRequest, TubeRequest, dict[str, str]]:
        """The vehicles that can be served now, those that may be by their limits alone, and why others cannot."""
        block = self.window.block(slots, min(self.window.size, self._method.samples_needed))
        epoch, seq, t, flags = self.window.newest(slots)
        served = TubeRequest(slots, epoch, seq, t, block, known)
        missing = self._method.missing(slots)
        no_model = missing > 0
        # A tube begins at a sample that another one confirms: one that strays alone bears none.
        strayed = ~self.window.followed(slots)
        reasons = [
            (~block.valid[:, -1], "no sample has come yet"),
            (flags & int(StateFlag.HISTORY) != 0, "the newest sample is recorded history"),
            *self._method.reasons(slots, block, known),
            (strayed, "the newest sample does not follow the one before it: one more will tell"),
        ]
        waiting: dict[str, str] = {}
        for mask, reason in reversed(reasons):
            waiting |= {self._names[slot]: reason for slot in slots[mask]}
        for row in np.flatnonzero(no_model).tolist():
            name = self._names[slots[row]]
            waiting[name] = too_few(self.method, int(missing[row]))
        refused = np.any([mask for mask, _ in reasons], axis=0)
        limited = np.flatnonzero(no_model & ~reasons[0][0] & ~reasons[1][0] & ~strayed)
        return served.rows(np.flatnonzero(~(no_model | refused))), served.rows(limited), waiting

    def _check(self, batch: SampleBatch, appended: AppendReport) -> list[EngineEvent]:
        """Hold the measurements that were stored against the one-step predictions that wait for them."""
        events: list[EngineEvent] = []
        slack = self.profile.tolerance * self.profile.sample_time_ns
        angles = tuple(np.flatnonzero(self.profile.angles).tolist())
        jumped = appended.status & ring.JUMPED != 0
        if appended.stored < len(jumped):
            batch, jumped = batch.take(np.flatnonzero(appended.stored_rows)), jumped[appended.stored_rows]
        checked = self._record.check(batch, slack, self.noise_of_claim, angles, jumped)
        for miss in checked.misses:
            if miss.side_information:
                self._record.unexplained[miss.slot] = miss.t
            elif self._labels.certain:
                self._record.refute(miss.slot)
                events.append(notices.miss(self._names[miss.slot], miss))
        newest = notices.newest_stamps(batch, checked.restored)
        events += [notices.restored(self._names[slot], newest[slot]) for slot in checked.restored.tolist()]
        moved = ((checked.left, "left its band"), (checked.returned, "is in its band again"))
        for slots, what in moved if self._labels.audited else ():
            newest, confidence = notices.newest_stamps(batch, slots), self.profile.confidence
            events += [
                notices.coverage(self._names[slot], newest[slot], what, self._record.audit(slot), confidence)
                for slot in slots.tolist()
            ]
        return events
