"""One step for a batch of vehicles of a class: windows, models, tubes, audit. Arrays in, arrays out; no clock."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fleet_bus.errors import UsageError
from fleet_bus.messages import Audit, EventKind, Label, StateFlag, VehicleProfile
from reach_server import audit, calibrated, model, results
from reach_server.assignments import Assignments
from reach_server.fitting import Models
from reach_server.inputs import future_inputs, limits
from reach_server.predicates import CutTable
from reach_server.regression import Layout, inputs_known, lagged_inputs, runs, unwrapped, wrap
from reach_server.results import EngineEvent, Tubes
from reach_server.rows import take, with_room
from reach_server.sets import planar, support
from reach_server.tube import FactorSet, Tube, apply_cuts, propagate
from reach_server.windows import Appended, Block, Floats, SampleBatch, Window
from side_info import Scenario

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
        self._assignments = Assignments(profile)
        self._predictions = audit.Predictions()
        #: By slot: predictions checked and held, last miss, and whether a stated bound turned out to be wrong.
        self._checked = np.zeros(0, dtype=np.int64)
        self._inside = np.zeros(0, dtype=np.int64)
        self._last_miss = np.zeros(0)
        self._falsified = np.zeros(0, dtype=bool)

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
            self._checked = with_room(self._checked, slot + 1, self._checked)
            self._inside = with_room(self._inside, slot + 1, self._inside)
            self._last_miss = with_room(self._last_miss, slot + 1, self._last_miss)
            self._falsified = with_room(self._falsified, slot + 1, self._falsified)
        return slot

    def reset(self, vehicle: str) -> None:
        """Forget samples, model and record of a vehicle; its slot and its scenarios stay."""
        slot = self._slots[vehicle]
        self.window.clear(slot)
        self._models.reset(slot)
        self._predictions.drop(slot)
        self._checked[slot] = self._inside[slot] = self._last_miss[slot] = 0
        self._falsified[slot] = False

    def assign(self, vehicle: str, scenario: Scenario, time_zero: int, clock_offset: float = 0.0) -> None:
        """Cut the tubes of a vehicle by a scenario from now on; raise ``ScenarioError`` if its states do not fit."""
        self._assignments.assign(self.add(vehicle), scenario, time_zero, clock_offset)

    def unassign(self, vehicle: str, scenario: str) -> None:
        """Stop cutting the tubes of a vehicle by a scenario."""
        self._assignments.unassign(self.add(vehicle), scenario)

    def audit_of(self, vehicle: str) -> Audit:
        """One-step predictions of a vehicle that were checked, and how many held."""
        slot = self._slots[vehicle]
        return Audit(int(self._checked[slot]), int(self._inside[slot]), float(self._last_miss[slot]))

    def window_filled(self) -> NDArray[np.int64]:
        """Samples held (V,), by slot."""
        return self.window.filled(np.arange(len(self._names)))

    def append(self, batch: SampleBatch) -> tuple[Appended, tuple[EngineEvent, ...]]:
        """Store samples without computing tubes; checks the predictions that waited for them."""
        events = self._check(batch)
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
        self._models.refit(self.window, slots)
        served, waiting = self._serve(slots, known)
        if not len(served.slots):
            return self._no_tubes(waiting)
        times = served.t[:, None] + np.arange(1, self.horizon + 1) * self.profile.sample_time_ns
        active = self._assignments.active(served.slots, np.concatenate([served.t[:, None], times], axis=1))
        cut_rows = np.flatnonzero(active.any(axis=(1, 2)))
        tube = self._tube(served, active, cut_rows)
        bounded = _bounded(tube, len(served.slots), cut_rows)
        if not bounded.all():
            for slot in served.slots[~bounded]:
                waiting[self._names[slot]] = "the sets grow beyond all numbers within the horizon: shorten it"
            if not bounded.any():
                return self._no_tubes(waiting)
            kept = np.flatnonzero(np.isin(slots, served.slots[bounded]))
            again = self.predict(slots[kept], None if known is None else take(known, kept))
            return replace(again, waiting=again.waiting | waiting)
        return self._publish(served, times, tube, cut_rows, waiting)

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

    def _tube(self, served: _Served, active: NDArray[np.bool_], cut_rows: NDArray[np.intp]) -> Tube:
        """Tubes without cuts for all rows, then with cuts for ``cut_rows``, in one batch."""
        both = np.concatenate([np.arange(len(served.slots)), cut_rows])
        masks = np.concatenate([np.zeros_like(active), active[cut_rows]])
        known = served.known
        if self.method == "calibrated":
            return self._calibrated_tube(served, masks, both)
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
        return propagate(
            take(start, both), take(inputs, both), take(models, both), self.bounds.process,
            self.layout, self._table, masks, cuts=self.profile.cuts, membership=self.method == "set_membership",
        )  # fmt: skip

    @property
    def _table(self) -> CutTable:
        """The cuts; for calibrated sets, which speak about measured states, widened by the measurement noise, so that
        none cuts where its bound is not stated."""
        table = self._assignments.table
        if self.method != "calibrated":
            return table
        margin = np.full(table.count, np.inf)
        if self.profile.noise.measurement is not None:
            margin = np.abs(table.normal @ self.bounds.measurement).sum(axis=1)
        return replace(table, lower=table.lower - margin, upper=table.upper + margin)

    def _calibrated_tube(self, served: _Served, masks: NDArray[np.bool_], both: NDArray[np.intp]) -> Tube:
        table, n = self._table, self.layout.n
        plan = served.known.plan if served.known is not None and self._planned else None
        center, generators, _ = calibrated.predict(
            self._models.of(served.slots), served.block, self.profile, self.layout, plan
        )
        steps = [FactorSet.zonotope(served.block.x[both, -1], np.zeros((len(both), n, 0)))]
        empty = np.zeros((len(both), self.horizon + 1, table.count), dtype=bool)
        cut = np.zeros_like(empty)
        for k in range(self.horizon):
            box = FactorSet.zonotope(center[both, k], generators[both, k])
            box, empty[:, k + 1], cut[:, k + 1] = apply_cuts(box, table, masks[:, k + 1], self.profile.cuts, n)
            steps.append(box)
        return Tube(steps, empty, cut, np.zeros(len(both), dtype=bool))

    def _publish(
        self, served: _Served, times: NDArray[np.int64], tube: Tube, cut_rows: NDArray[np.intp], waiting: dict[str, str]
    ) -> Tubes:
        """The result of a round; where cuts leave nothing, the sets without cuts and an event."""
        count = len(served.slots)
        events = self._contradictions(served, tube, cut_rows)
        sound = ~tube.empty[count:].any(axis=(1, 2))
        source = np.arange(count)
        source[cut_rows[sound]] = count + np.flatnonzero(sound)
        cut = tube.cut[source, 1:]
        steps = tuple(take(s, source) for s in tube.steps[1:])
        free = tuple(take(s, slice(0, count)) for s in tube.steps[1:])
        plane = self.profile.position
        figures = [results.figures(s, cut[:, k], self._table, plane) for k, s in enumerate(steps)]
        area = np.stack([f.area for f in figures], axis=1)
        free_area = area.copy()
        for k, s in enumerate(free):
            free_area[cut_rows, k] = planar.zonotope_area(s.generators[cut_rows][:, plane, :])
        self._predictions.keep(served.slots, served.epoch, served.seq, times[:, 0], steps[0], free[0])
        slots = served.slots.tolist()
        deficient = self._models.rank_deficient(served.slots).tolist()
        contradicted = self._assignments.contradicted()
        return Tubes(
            tuple(self._names[slot] for slot in slots), served.epoch, served.seq, served.t, times, steps, free,
            area, free_area, np.stack([f.outline for f in figures], axis=1),
            np.stack([f.hull for f in figures], axis=1), tuple(self._label(slot) for slot in slots), self.method,
            self._assignments.describe(served.slots, cut),
            tuple(
                self._notes(rank_deficient=bad, contradicted=slot in contradicted)
                for slot, bad in zip(slots, deficient, strict=True)
            ),
            tuple(events), waiting,
        )  # fmt: skip

    def _no_tubes(self, waiting: dict[str, str]) -> Tubes:
        ids, times = np.zeros(0, dtype=np.uint64), np.zeros((0, self.horizon), dtype=np.int64)
        areas, sets = np.zeros((0, self.horizon)), np.zeros((0, self.horizon, 2, self.layout.n))
        return Tubes(
            (), ids, ids, times[:, 0], times, (), (), areas, areas, sets, sets, (), self.method, (), (), (), waiting
        )

    def _contradictions(self, served: _Served, tube: Tube, cut_rows: NDArray[np.intp]) -> list[EngineEvent]:
        """Events where cuts left nothing, and where the data excludes the stated bounds."""
        events: list[EngineEvent] = []
        count = len(served.slots)
        for row, empty in zip(cut_rows.tolist(), tube.empty[count:], strict=True):
            if empty.any():
                slot = int(served.slots[row])
                events += self._assignments.contradict(slot, self._names[slot], int(served.t[row]), empty)
        for row in np.flatnonzero(tube.contradicted[:count]).tolist():
            slot = int(served.slots[row])
            if not self._falsified[slot]:
                message = "the data contradicts the stated noise or Lipschitz bounds: widen them in the profile"
                vehicle, t = self._names[slot], int(served.t[row])
                events.append(EngineEvent(EventKind.DATA_CONTRADICTED, vehicle, t, message))
            self._falsified[slot] = True
        return events

    def _check(self, batch: SampleBatch) -> list[EngineEvent]:
        """Hold the measurements against the one-step predictions that wait for them."""
        events: list[EngineEvent] = []
        slack = self.profile.tolerance * self.profile.sample_time_ns
        for row, slot, held, excess, free_held in self._predictions.check(
            batch, slack, self.noise_of_claim, self.layout.angles
        ):
            self._checked[slot] += 1
            self._inside[slot] += held
            if not held:
                self._last_miss[slot] = excess
                events += self._miss(slot, int(batch.t[row]), excess, side_information=free_held)
        return events

    def _miss(self, slot: int, t: int, excess: float, *, side_information: bool) -> list[EngineEvent]:
        vehicle = self._names[slot]
        if side_information:
            return self._assignments.contradict(slot, vehicle, t, None)
        if self.method == "calibrated":
            return []
        self._falsified[slot] = True
        message = f"the measured state lay outside its predicted set by {excess:.3g}: a stated bound is wrong, widen it"
        return [EngineEvent(EventKind.MISS, vehicle, t, message, {"excess": excess})]

    def _label(self, slot: int) -> Label:
        if self.method == "calibrated":
            return Label.CALIBRATED
        if self._falsified[slot]:
            return Label.CONTRADICTED
        noise = self.profile.noise
        if noise.process is None or noise.measurement is None or self._lipschitz is None:
            return Label.UNCOVERED
        return Label.GUARANTEED if self.profile.guaranteed else Label.CALIBRATED

    def _notes(self, *, rank_deficient: bool, contradicted: bool) -> tuple[str, ...]:
        notes = ["rank deficient"] if rank_deficient else []
        if self.method == "calibrated":
            notes += [] if self._planned else ["learned driver"]
        elif self._lipschitz is None:
            notes.append("no Lipschitz bound")
        if contradicted:
            notes.append("side information contradicted")
        return tuple(notes)


def _bounded(tube: Tube, count: int, cut_rows: NDArray[np.intp]) -> NDArray[np.bool_]:
    """Which of the first ``count`` vehicles have finite sets only, with cuts and without."""
    finite = np.ones(len(tube.contradicted), dtype=bool)
    for sets in tube.steps:
        finite &= np.isfinite(sets.center).all(axis=1) & np.isfinite(sets.generators).all(axis=(1, 2))
    bounded = finite[:count].copy()
    np.logical_and.at(bounded, cut_rows, finite[count:])
    return bounded
