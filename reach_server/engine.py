"""One step for a batch of vehicles of a class: windows, models, tubes, audit. Arrays in, arrays out; no clock."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fleet_bus.errors import UsageError
from fleet_bus.messages import Audit, EventKind, Label, StateFlag, VehicleProfile
from reach_server import calibrated, model
from reach_server.assignments import Assignments, Instants
from reach_server.factor_sets import FactorSet
from reach_server.figures import PlaneStrips, of_tracks, where_smaller
from reach_server.fitting import Models
from reach_server.inputs import future_inputs, limits
from reach_server.record import Record
from reach_server.recursion import Recursion
from reach_server.regression import Layout, inputs_known, lagged_inputs, runs, unwrapped, wrap
from reach_server.results import EngineEvent, Tubes
from reach_server.rows import take
from reach_server.sets import support
from reach_server.sets.arrays import stack_columns
from reach_server.tube import Knowledge, Motion, Tracks, Tube, propagate
from reach_server.windows import Appended, Block, Floats, SampleBatch, Window
from side_info import Scenario
from side_info.progression import TRUE

METHODS = ("calibrated", "set_membership", "residual_hull", "paper")


@dataclass(frozen=True, slots=True, eq=False)
class KnownInputs:
    """Later inputs of a batch that are known: ``plan`` (B, N - 1, m), within ``tolerance`` (B, m)."""

    plan: Floats
    tolerance: Floats


@dataclass(frozen=True, slots=True, eq=False)
class _Served:
    """The vehicles of one round that get a tube: slots (B,), their newest sample, block and known later inputs."""

    slots: NDArray[np.intp]
    epoch: NDArray[np.uint64]
    seq: NDArray[np.uint64]
    t: NDArray[np.int64]
    block: Block
    known: KnownInputs | None

    def rows(self, rows: NDArray[np.intp]) -> "_Served":
        """Those of some rows."""
        known = None if self.known is None else take(self.known, rows)
        return _Served(self.slots[rows], self.epoch[rows], self.seq[rows], self.t[rows], take(self.block, rows), known)


class Engine:
    """Reachable sets of the vehicles of one class.

    Args:
        profile: the class.
        method: overrides the profile's method; ``default`` is ``set_membership`` where every bound is given, else
            ``calibrated``; ``paper`` is ``residual_hull`` in the world frame, as printed.
        horizon: overrides the profile's.
        planned: later inputs will be given to ``step`` (the calibrated model then uses them).
    """

    def __init__(
        self, profile: VehicleProfile, *, method: str | None = None, horizon: int | None = None, planned: bool = False
    ) -> None:
        self.profile = profile
        wanted = method or profile.method
        self.method = ("set_membership" if profile.guaranteed else "calibrated") if wanted == "default" else wanted
        if self.method not in METHODS:
            raise UsageError(f"method {wanted!r} is unknown: choose one of default, {', '.join(METHODS)}")
        self.horizon = horizon or profile.horizon
        self.layout = Layout.of(profile, "world" if self.method == "paper" else None)
        self.bounds = model.NoiseBounds.of(profile, self.layout)
        # Bounds of body-frame derivatives say nothing about the world-frame model.
        world_of_body = profile.frame == "body" and self.layout.pose is None
        self._lipschitz = None if world_of_body else profile.lipschitz
        self._planned = planned
        self.window = Window(profile)
        if profile.cuts == "constrained":
            # Compiles on the first run after an installation, better here than in the middle of a round.
            support.warm_up()
        self._models = Models(
            profile, self.layout, self.bounds, self._lipschitz,
            horizon=self.horizon, is_calibrated=self.method == "calibrated", planned=planned,
        )  # fmt: skip
        self._slots: dict[str, int] = {}
        self._names: list[str] = []
        known = profile.noise.measurement is not None
        if self.method == "calibrated":
            # Calibrated sets speak about measured states.
            noise = received = self.bounds.measurement if known else None
        else:
            noise, received = np.zeros((self.layout.n, 0)), self.bounds.measurement
        self._assignments = Assignments(profile, noise, received, self.horizon)
        self._record = Record()

    @property
    def vehicles(self) -> tuple[str, ...]:
        """Ids of the vehicles, by slot."""
        return tuple(self._names)

    @property
    def noise_of_claim(self) -> Floats:
        """Generators (n, g) by which a measured state may lie outside of a true set; none for calibrated sets, which
        speak about measured states."""
        return np.zeros((self.layout.n, 0)) if self.method == "calibrated" else self.bounds.measurement

    def add(self, vehicle: str) -> int:
        """Slot of a vehicle, made if it is new."""
        slot = self._slots.get(vehicle)
        if slot is None:
            slot = self._slots[vehicle] = len(self._names)
            self._names.append(vehicle)
            self.window.grow(slot + 1)
            self._models.grow(slot + 1)
            self._record.grow(slot + 1)
        return slot

    def reset(self, vehicle: str) -> None:
        """Forget samples, model and record of a vehicle; its slot and its scenarios stay."""
        slot = self._slots[vehicle]
        self.window.clear(slot)
        self._models.reset(slot)
        self._record.reset(slot)

    def assign(self, vehicle: str, scenario: Scenario, time_zero: int, clock_offset: float = 0.0) -> None:
        """Cut the tubes of a vehicle by a scenario from now on; raise ``ScenarioError`` if its states do not fit."""
        for slot in self._assignments.assign(self.add(vehicle), scenario, time_zero, clock_offset):
            # What another scenario has cut must not be held against this one.
            self._record.predictions.drop(slot)

    def unassign(self, vehicle: str, scenario: str) -> None:
        """Stop cutting the tubes of a vehicle by a scenario."""
        slot = self.add(vehicle)
        self._assignments.unassign(slot, scenario)
        self._record.predictions.drop(slot)

    def audit_of(self, vehicle: str) -> Audit:
        """One-step predictions of a vehicle that were checked, and how many held."""
        return self._record.audit(self._slots[vehicle])

    def window_filled(self) -> NDArray[np.int64]:
        """Samples held (V,), by slot."""
        return self.window.filled(np.arange(len(self._names)))

    def append(self, batch: SampleBatch) -> tuple[Appended, tuple[EngineEvent, ...]]:
        """Store samples without computing tubes; checks the predictions that waited for them."""
        events = self._check(batch)
        recorded = batch.flags & int(StateFlag.HISTORY) != 0
        begins = ~recorded & ((batch.flags & int(StateFlag.NEW_TRAJECTORY) != 0) | (batch.seq == 0))
        if begins.any():
            order = list(zip(batch.epoch[begins].tolist(), batch.seq[begins].tolist(), strict=True))
            self._assignments.began(batch.vehicle[begins], batch.t[begins], order)
        appended = self.window.append(batch)
        self._models.count(batch.vehicle)
        return appended, tuple(events)

    def step(self, batch: SampleBatch, known: KnownInputs | None = None) -> Tubes:
        """Store samples and return the tubes from the newest sample of each vehicle in the batch.

        ``known`` has one row per vehicle, in ascending order of slots.
        """
        _, events = self.append(batch)
        tubes = self.predict(np.unique(batch.vehicle), known)
        return replace(tubes, events=events + tubes.events)

    def predict(self, slots: NDArray[np.intp], known: KnownInputs | None = None) -> Tubes:
        """Tubes from the newest samples of some slots (ascending); ``known`` has one row per slot."""
        events = self._receive(slots)
        self._models.refit(self.window, slots)
        served, waiting = self._serve(slots, known)
        while len(served.slots):
            times = served.t[:, None] + np.arange(1, self.horizon + 1) * self.profile.sample_time_ns
            tracks, motion, instants = self._tracks(served)
            knowledge = self._knowledge(tracks, instants)
            tube = propagate(tracks, motion, knowledge, self.layout.n)
            bounded = _bounded(tube, tracks)
            if bounded.all():
                published = self._publish(served, times, tube, tracks, instants, waiting)
                return replace(published, events=(*events, *published.events))
            for slot in served.slots[~bounded]:
                waiting[self._names[slot]] = "the sets grow beyond all numbers within the horizon: shorten it"
            served = served.rows(np.flatnonzero(bounded))
        return replace(self._no_tubes(waiting), events=tuple(events))

    def _receive(self, slots: NDArray[np.intp]) -> list[EngineEvent]:
        """Let the scenarios see what has been measured of some vehicles."""
        held = slots[self.window.filled(slots) > 0]
        newest = self.window.newest(held)[2]
        if not len(held):
            return []

        def block(wanted: NDArray[np.intp], length: int) -> Block:
            samples = self.window.block(wanted, min(length, self.window.size))
            # What was recorded before the vehicle started is no part of what scenarios speak about.
            return replace(samples, valid=samples.valid & ~self.window.recorded(wanted, samples.t.shape[1]))

        events = self._assignments.receive(held, self._names, newest, block)
        # What lay outside of a set only because of side information, and no predicate explains.
        for slot in sorted(self._record.doubted.keys() & set(held.tolist())):
            t = self._record.doubted.pop(slot)
            if not any(event.vehicle == self._names[slot] for event in events):
                events += self._assignments.contradict(slot, self._names[slot], t, None)
        return events

    def _serve(self, slots: NDArray[np.intp], known: KnownInputs | None) -> tuple[_Served, dict[str, str]]:
        """The vehicles that can be served now, and why the others cannot."""
        block = self.window.block(slots, min(self.window.size, self.layout.lags + calibrated.LAGGED_INCREMENTS + 1))
        epoch, seq, t, flags = self.window.newest(slots)
        if self.method == "calibrated":
            complete = inputs_known(block, runs(block.linked), self.layout)[:, -1]
            complete &= runs(block.linked)[:, -1] >= calibrated.LAGGED_INCREMENTS
            limited = np.ones(len(slots), dtype=bool)
        else:
            # The current input may be anything within its limits, the lagged ones are needed.
            complete = self._lags_known(block)
            has_limits = bool(np.isfinite(np.concatenate(limits(self.profile))).all())
            needs_limits = ~block.input_known[:, -1] | (known is None and self.horizon > 1)
            limited = ~needs_limits | has_limits
        reasons = (
            (~self._models.ready(slots), f"too few samples for {self.method}"),
            (flags & int(StateFlag.HISTORY) != 0, "the newest sample is recorded history"),
            (~complete, "the lagged inputs are not complete yet"),
            (~limited, "no plan came, and the profile states no limits for an input"),
        )
        waiting: dict[str, str] = {}
        for mask, reason in reversed(reasons):
            waiting |= {self._names[slot]: reason for slot in slots[mask]}
        rows = np.flatnonzero(~np.any([mask for mask, _ in reasons], axis=0))
        chosen = None if known is None else take(known, rows)
        return _Served(slots[rows], epoch[rows], seq[rows], t[rows], take(block, rows), chosen), waiting

    def _lags_known(self, block: Block) -> NDArray[np.bool_]:
        known = block.valid[:, -1].copy()
        if self.layout.lags:
            known &= block.linked[:, -self.layout.lags :].all(axis=1)
            known &= block.input_known[:, -self.layout.lags - 1 : -1].all(axis=1)
        return known

    def _tracks(self, served: _Served) -> tuple[Tracks, Motion, Instants]:
        """A tube without side information for each vehicle, and one with it where a scenario asks for something."""
        count = len(served.slots)
        row, obligation, tested = self._assignments.obligations(served.slots)
        with_side = np.unique(row)
        vehicle = np.concatenate([np.arange(count), with_side])
        track = np.concatenate([np.arange(count), count + np.searchsorted(with_side, row)])
        asked = np.concatenate([np.full(count, TRUE, dtype=np.int64), obligation])
        motion, start = self._calibrated_motion(served) if self.method == "calibrated" else self._recursion(served)
        half = np.abs(self.bounds.measurement).sum(axis=1)
        measured = start.center[:, : self.layout.n]
        instants = Instants(served.slots, served.t, measured - half, measured + half)
        return Tracks(vehicle, take(start, vehicle), track, asked, tested[vehicle], vehicle), motion, instants

    def _knowledge(self, tracks: Tracks, instants: Instants) -> Knowledge:
        side = self._assignments
        contexts = side.contexts(instants)
        return Knowledge(
            side.table,
            side.literals,
            lambda k, track: contexts(k, tracks.vehicle[track]),
            self.profile.cuts,
            side.plane,
        )

    def _recursion(self, served: _Served) -> tuple[Recursion, FactorSet]:
        known = served.known
        measurement = self.bounds.measurement
        models = self._models.of(served.slots)
        x = unwrapped(served.block, self.layout)[:, -1]
        if self.layout.pose is None:
            turns = list(self.layout.angles)
            x[:, turns] = models.newest[:, turns] + wrap(x[:, turns] - models.newest[:, turns])
        start = FactorSet.zonotope(x, np.broadcast_to(measurement, (len(x), *measurement.shape)))
        u = lagged_inputs(served.block, self.layout)[:, -1].reshape(-1, self.layout.lags + 1, self.layout.m)
        inputs = future_inputs(
            self.profile, u[:, 1:], u[:, 0], served.block.input_known[:, -1], self.horizon,
            None if known is None else known.plan, None if known is None else known.tolerance,
        )  # fmt: skip
        return Recursion(inputs, models, self.bounds.process, self.layout, self.method == "set_membership"), start

    def _calibrated_motion(self, served: _Served) -> tuple["calibrated.Boxes", FactorSet]:
        plan = served.known.plan if served.known is not None and self._planned else None
        center, generators, _ = calibrated.predict(
            self._models.of(served.slots), served.block, self.profile, self.layout, plan
        )
        x = served.block.x[:, -1]
        return calibrated.Boxes(center, generators), FactorSet.zonotope(x, np.zeros((*x.shape, 0)))

    def _publish(
        self,
        served: _Served,
        times: NDArray[np.int64],
        tube: Tube,
        tracks: Tracks,
        instants: Instants,
        waiting: dict[str, str],
    ) -> Tubes:
        """The result of a round; where cuts leave nothing, the sets without cuts and an event."""
        count = len(served.slots)
        events = self._contradictions(served, tube, tracks)
        sound = tube.ended[count:] < 0
        cut, rows = count + np.flatnonzero(sound), tracks.vehicle[count:][sound]
        chosen = np.arange(count)
        chosen[rows] = cut
        plane = self.profile.position
        acted = np.flatnonzero(tube.acted.any(axis=(0, 1))).tolist()
        strips = PlaneStrips.of(self._assignments.literals, acted, self.layout.n, plane)
        free = [of_tracks(step, np.arange(count), strips, plane) for step in tube.steps[1:]]
        # The paper's cuts are shown as they are, larger or not.
        always = self.profile.cuts == "frobenius"
        found = [
            where_smaller(whole, of_tracks(step, cut, strips, plane), rows, always=always) if len(rows) else whole
            for step, whole in zip(tube.steps[1:], free, strict=True)
        ]
        steps, free_steps = tuple(s for s, _ in found), tuple(s for s, _ in free)
        self._record.predictions.keep(served.slots, served.epoch, served.seq, times[:, 0], steps[0], free_steps[0])
        slots = served.slots.tolist()
        deficient = self._models.rank_deficient(served.slots).tolist()
        contradicted = self._assignments.contradicted()
        emptied = np.zeros(count, dtype=bool)
        emptied[tracks.vehicle[count:]] = ~sound
        return Tubes(
            tuple(self._names[slot] for slot in slots), served.epoch, served.seq, served.t, times, steps, free_steps,
            np.stack([f.area for _, f in found], axis=1), np.stack([f.area for _, f in free], axis=1),
            np.stack([f.outline() for _, f in found], axis=1), np.stack([f.hull for _, f in found], axis=1),
            tuple(self._label(slot) for slot in slots), self.method,
            self._assignments.describe(tube.acted[chosen, 1:]),
            tuple(
                self._notes(rank_deficient=bad, contradicted=slot in contradicted, emptied=nothing)
                for slot, bad, nothing in zip(slots, deficient, emptied.tolist(), strict=True)
            ),
            self._verdicts(instants, steps), tuple(events), waiting,
        )  # fmt: skip

    def _verdicts(self, instants: Instants, steps: tuple[FactorSet, ...]) -> tuple[Mapping[str, str], ...]:
        """What the requirements come to on the sets, enlarged to hold true states where they speak about measured
        ones."""
        noise = self.bounds.measurement if self.method == "calibrated" else np.zeros((self.layout.n, 0))
        return self._assignments.verdicts(instants, [(s.center, stack_columns(s.generators, noise)) for s in steps])

    def _no_tubes(self, waiting: dict[str, str]) -> Tubes:
        ids, times = np.zeros(0, dtype=np.uint64), np.zeros((0, self.horizon), dtype=np.int64)
        areas, sets = np.zeros((0, self.horizon)), np.zeros((0, self.horizon, 2, self.layout.n))
        return Tubes(
            (), ids, ids, times[:, 0], times, (), (), areas, areas, sets, sets, (), self.method, (), (), (), (), waiting
        )

    def _contradictions(self, served: _Served, tube: Tube, tracks: Tracks) -> list[EngineEvent]:
        """Events where cuts left nothing, and where the data excludes the stated bounds."""
        events: list[EngineEvent] = []
        count = len(served.slots)
        # A calibrated set may be wrong itself: only what was measured contradicts for good.
        final = tube.ended >= 0 if self.method != "calibrated" else np.zeros(tracks.count, dtype=bool)
        for track in np.flatnonzero(final).tolist():
            row = int(tracks.vehicle[track])
            # What cut before may be as wrong as what left nothing: all scenarios that took part are named.
            before = tube.acted[track].any(axis=0)
            literals = np.flatnonzero(
                tube.blamed[track] | self._assignments.of_others(before, tube.blamed[track])
            ).tolist()
            slot, ahead = int(served.slots[row]), int(tube.ended[track]) * self.profile.sample_time_ns
            events += self._assignments.contradict(slot, self._names[slot], int(served.t[row]), literals, ahead)
        for row in np.flatnonzero(tube.contradicted[:count]).tolist():
            slot = int(served.slots[row])
            if not self._record.falsified[slot]:
                message = "the data contradicts the stated noise or Lipschitz bounds: widen them in the profile"
                vehicle, t = self._names[slot], int(served.t[row])
                events.append(EngineEvent(EventKind.DATA_CONTRADICTED, vehicle, t, message))
            self._record.falsified[slot] = True
        return events

    def _check(self, batch: SampleBatch) -> list[EngineEvent]:
        """Hold the measurements against the one-step predictions that wait for them."""
        events: list[EngineEvent] = []
        slack = self.profile.tolerance * self.profile.sample_time_ns
        for miss in self._record.check(batch, slack, self.noise_of_claim, self.layout.angles):
            if miss.side_information:
                self._record.doubted[miss.slot] = miss.t
            elif self.method != "calibrated":
                self._record.falsified[miss.slot] = True
                message = (
                    f"the measured state lay outside its predicted set by {miss.excess:.3g}: "
                    "a stated bound is wrong, widen it"
                )
                vehicle = self._names[miss.slot]
                events.append(EngineEvent(EventKind.MISS, vehicle, miss.t, message, {"excess": miss.excess}))
        return events

    def _label(self, slot: int) -> Label:
        if self.method == "calibrated":
            return Label.CALIBRATED
        if self._record.falsified[slot]:
            return Label.CONTRADICTED
        noise = self.profile.noise
        if noise.process is None or noise.measurement is None or self._lipschitz is None:
            return Label.UNCOVERED
        return Label.GUARANTEED if self.profile.guaranteed else Label.CALIBRATED

    def _notes(self, *, rank_deficient: bool, contradicted: bool, emptied: bool) -> tuple[str, ...]:
        notes = ["rank deficient"] if rank_deficient else []
        if self.method == "calibrated":
            notes += [] if self._planned else ["learned driver"]
        elif self._lipschitz is None:
            notes.append("no Lipschitz bound")
        if contradicted:
            notes.append("side information contradicted")
        elif emptied:
            notes.append("side information left nothing")
        return tuple(notes)


def _bounded(tube: Tube, tracks: Tracks) -> NDArray[np.bool_]:
    """Which vehicles (B,) have finite sets only, with cuts and without."""
    bounded = np.ones(int(tracks.vehicle.max()) + 1, dtype=bool)
    for step in tube.steps:
        finite = np.isfinite(step.sets.center).all(axis=1) & np.isfinite(step.sets.generators).all(axis=(1, 2))
        np.logical_and.at(bounded, tracks.vehicle[step.track], finite)
    return bounded
