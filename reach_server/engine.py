"""One step for a batch of vehicles of a class: windows, models, tubes, audit. Arrays in, arrays out; no clock."""

from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fleet_bus.errors import UsageError
from fleet_bus.messages import Audit, EventKind, Label, StateFlag, VehicleProfile
from reach_server import audit, calibrated, model, results
from reach_server.assignments import Assignments
from reach_server.inputs import future_inputs
from reach_server.predicates import CutTable
from reach_server.regression import Layout, inputs_known, lagged_inputs, runs, transitions, unwrapped
from reach_server.results import EngineEvent, Tubes
from reach_server.sets import planar
from reach_server.tube import FactorSet, Tube, apply_cuts, propagate
from reach_server.windows import Appended, Block, Floats, SampleBatch, Window
from side_info import Scenario

#: A vehicle's model is fitted again after this many new samples.
REFIT_EVERY = 10


@dataclass(frozen=True, slots=True, eq=False)
class KnownInputs:
    """Later inputs of a batch that are known: ``plan`` (B, N - 1, m), within ``tolerance`` (B, m)."""

    plan: Floats
    tolerance: Floats | None = None


class Engine:
    """Reachable sets of the vehicles of one class.

    Args:
        profile: the class.
        method: overrides the profile's method; ``default`` is ``set_membership`` where every bound is given, else
            ``calibrated``; ``paper`` is ``residual_hull`` in the world frame, as printed.
        horizon: overrides the profile's.
        frame: overrides the frame of the method.
        planned: later inputs will be given to ``step`` (the calibrated model then uses them).
    """

    def __init__(
        self,
        profile: VehicleProfile,
        *,
        method: str | None = None,
        horizon: int | None = None,
        frame: str | None = None,
        planned: bool = False,
        window: Window | None = None,
    ) -> None:
        self.profile = profile
        wanted = method or profile.method
        self.method = ("set_membership" if profile.guaranteed else "calibrated") if wanted == "default" else wanted
        if self.method not in ("calibrated", "set_membership", "residual_hull", "paper"):
            raise UsageError(
                f"method {wanted!r} is unknown: choose default, calibrated, set_membership, residual_hull or paper"
            )
        self.horizon = horizon or profile.horizon
        self.layout = Layout.of(profile, frame or ("world" if self.method == "paper" else None))
        self.bounds = model.NoiseBounds.of(profile, self.layout)
        if profile.frame == "body" and self.layout.pose is None:
            # Bounds of body-frame derivatives say nothing about the world-frame model.
            self._lipschitz = None
        else:
            self._lipschitz = profile.lipschitz
        self._planned = planned
        self.window = window or Window(profile)
        self._slots: dict[str, int] = {}
        self._names: list[str] = []
        self._assignments = Assignments(profile)
        self._store: model.Model | calibrated.Calibrated | None = None
        self._since_fit = np.zeros(0, dtype=np.int64)
        self._fitted = np.zeros(0, dtype=bool)
        self._ready = np.zeros(0, dtype=bool)
        self._falsified = np.zeros(0, dtype=bool)
        self._checked = np.zeros(0, dtype=np.int64)
        self._inside = np.zeros(0, dtype=np.int64)
        self._last_miss = np.zeros(0)
        self._pending: dict[int, tuple[int, int, int, FactorSet, FactorSet]] = {}

    @property
    def vehicles(self) -> tuple[str, ...]:
        """Ids of the vehicles, by slot."""
        return tuple(self._names)

    def add(self, vehicle: str) -> int:
        """Slot of a vehicle, made if it is new."""
        slot = self._slots.get(vehicle)
        if slot is None:
            slot = self._slots[vehicle] = len(self._names)
            self._names.append(vehicle)
            self.window.grow(slot + 1)
            for name in (
                "_since_fit",
                "_fitted",
                "_ready",
                "_falsified",
                "_checked",
                "_inside",
                "_last_miss",
            ):
                array = getattr(self, name)
                setattr(self, name, np.append(array, array.dtype.type(0)))
        return slot

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
        self._since_fit += np.bincount(batch.vehicle, minlength=len(self._since_fit))
        return appended, tuple(events)

    def step(self, batch: SampleBatch, known: KnownInputs | None = None) -> Tubes:
        """Store samples and return the tubes from the newest sample of each vehicle in the batch.

        ``known`` has one row per vehicle, in ascending order of slots.
        """
        _, events = self.append(batch)
        return self.predict(np.unique(batch.vehicle), known, events)

    def predict(
        self, slots: NDArray[np.intp], known: KnownInputs | None = None, events: tuple[EngineEvent, ...] = ()
    ) -> Tubes:
        """Tubes from the newest samples of some slots (ascending)."""
        found = list(events)
        waiting: dict[str, str] = {}
        self._refit(slots)
        block = self.window.block(slots, min(self.window.size, self.layout.lags + calibrated.LAGGED_INCREMENTS + 1))
        complete = inputs_known(block, runs(block.linked), self.layout)[:, -1]
        if self.method != "calibrated":
            # The current input may be unknown, the lagged ones must not.
            complete = self._lags_known(block)
        _, _, _, flags = self.window.newest(slots)
        history = flags & int(StateFlag.HISTORY) != 0
        served = self._ready[slots] & complete & ~history
        for slot, ready, lags in zip(slots[~served], self._ready[slots][~served], complete[~served], strict=True):
            waiting[self._names[slot]] = self._why(int(slot), bool(ready), bool(lags))
        rows = np.flatnonzero(served)
        if not len(rows):
            return self._no_tubes(tuple(found), waiting)
        slots = slots[rows]
        block = Block(**{f.name: getattr(block, f.name)[rows] for f in fields(Block)})
        epoch, seq, t, _ = self.window.newest(slots)
        times = t[:, None] + np.arange(1, self.horizon + 1) * self.profile.sample_time_ns
        if known is not None:
            tolerance = None if known.tolerance is None else known.tolerance[rows]
            known = KnownInputs(known.plan[rows], tolerance)
        active = self._assignments.active(slots, np.concatenate([t[:, None], times], axis=1))
        cut_rows = np.flatnonzero(active.any(axis=(1, 2)))
        tube = self._tube(slots, block, known, active, cut_rows)
        steps, free, cut, contradicted = self._split(tube, len(slots), cut_rows, slots, t, found)
        plane = self.profile.position
        figures = [results.figures(s, cut[:, k], self._assignments.table, plane) for k, s in enumerate(steps)]
        area = np.stack([f.area for f in figures], axis=1)
        free_area = area.copy()
        for k in range(self.horizon):
            if len(cut_rows):
                free_area[cut_rows, k] = planar.zonotope_area(free[k].generators[cut_rows][:, plane, :])
        for i, slot in enumerate(slots):
            self._pending[int(slot)] = (
                int(epoch[i]),
                int(seq[i]),
                int(times[i, 0]),
                _take(steps[0], [i]),
                _take(free[0], [i]),
            )
        labels = tuple(self._label(int(slot), bool(bad)) for slot, bad in zip(slots, contradicted, strict=True))
        return Tubes(
            tuple(self._names[s] for s in slots), epoch, seq, t, times, steps, free, area, free_area,
            np.stack([f.outline for f in figures], axis=1), np.stack([f.hull for f in figures], axis=1),
            labels, self.method, self._assignments.describe(slots, cut), tuple(self._notes(int(s)) for s in slots),
            tuple(found), waiting,
        )  # fmt: skip

    def _no_tubes(self, events: tuple[EngineEvent, ...], waiting: dict[str, str]) -> Tubes:
        nothing, none = np.zeros(0, dtype=np.uint64), np.zeros((0, self.horizon))
        t, sets = np.zeros(0, dtype=np.int64), np.zeros((0, self.horizon, 2, self.layout.n))
        return Tubes(
            (), nothing, nothing, t, none.astype(np.int64), (), (), none, none, sets, sets, (), self.method, (), (),
            events, waiting,
        )  # fmt: skip

    def _lags_known(self, block: Block) -> NDArray[np.bool_]:
        lags = self.layout.lags
        if lags == 0:
            return block.valid[:, -1]
        return (
            block.valid[:, -1] & block.linked[:, -lags:].all(axis=1) & block.input_known[:, -lags - 1 : -1].all(axis=1)
        )

    def _why(self, slot: int, ready: bool, lags: bool) -> str:
        if not ready:
            return f"the window holds {int(self.window.filled(np.array([slot]))[0])} samples, too few for {self.method}"
        return "the newest sample is recorded history" if lags else "the lagged inputs are not complete yet"

    def _tube(
        self,
        slots: NDArray[np.intp],
        block: Block,
        known: KnownInputs | None,
        active: NDArray[np.bool_],
        cut_rows: NDArray[np.intp],
    ) -> Tube:
        """Tubes without cuts for all rows, then with cuts for ``cut_rows``, in one batch."""
        table = self._assignments.table
        both = np.concatenate([np.arange(len(slots)), cut_rows])
        masks = np.concatenate([np.zeros_like(active), active[cut_rows]])
        x = unwrapped(block, self.layout)[:, -1]
        if self.method == "calibrated":
            return self._calibrated_tube(slots, block, known, masks, both, table)
        start = FactorSet.zonotope(
            x, np.broadcast_to(self.bounds.measurement, (len(x), *self.bounds.measurement.shape))
        )
        m, lags = self.layout.m, self.layout.lags
        u = lagged_inputs(block, self.layout)[:, -1].reshape(-1, lags + 1, m)
        inputs = future_inputs(
            self.profile, u[:, 1:], u[:, 0], block.input_known[:, -1], self.horizon,
            None if known is None else known.plan, None if known is None else known.tolerance,
        )  # fmt: skip
        assert isinstance(self._store, model.Model)
        return propagate(
            _take(start, both), _take(inputs, both), _take(self._store, slots[both]), self.bounds.process, self.layout,
            table, masks, cuts=self.profile.cuts, membership=self.method == "set_membership",
        )  # fmt: skip

    def _calibrated_tube(
        self,
        slots: NDArray[np.intp],
        block: Block,
        known: KnownInputs | None,
        masks: NDArray[np.bool_],
        both: NDArray[np.intp],
        table: CutTable,
    ) -> Tube:
        assert isinstance(self._store, calibrated.Calibrated)
        plan = known.plan if known is not None and self._planned else None
        center, generators, _ = calibrated.predict(_take(self._store, slots), block, self.profile, self.layout, plan)
        steps: list[FactorSet] = [FactorSet.zonotope(block.x[both, -1], np.zeros((len(both), self.layout.n, 0)))]
        empty = np.zeros((len(both), self.horizon + 1, table.count), dtype=bool)
        cut = np.zeros_like(empty)
        for k in range(self.horizon):
            box = FactorSet.zonotope(center[both, k], generators[both, k])
            box, empty[:, k + 1], cut[:, k + 1] = apply_cuts(
                box, table, masks[:, k + 1], self.profile.cuts, self.layout.n
            )
            steps.append(box)
        return Tube(steps, empty, cut, np.zeros(len(both), dtype=bool))

    def _split(
        self,
        tube: Tube,
        count: int,
        cut_rows: NDArray[np.intp],
        slots: NDArray[np.intp],
        t: NDArray[np.int64],
        events: list[EngineEvent],
    ) -> tuple[tuple[FactorSet, ...], tuple[FactorSet, ...], NDArray[np.bool_], NDArray[np.bool_]]:
        """Steps 1 to N with and without cuts, which cuts acted, where the data contradicts the bounds.

        Where the cuts leave nothing the side information is contradicted: event, no more cuts by that scenario,
        and the set without cuts is what comes back.
        """
        free_rows = np.arange(count)
        source = free_rows.copy()
        cut = np.zeros((count, self.horizon + 1, tube.cut.shape[2]), dtype=bool)
        for position, row in enumerate(cut_rows):
            place = count + position
            if tube.empty[place].any():
                events += self._assignments.contradict(
                    int(slots[row]), self._names[slots[row]], int(t[row]), tube.empty[place]
                )
                continue
            source[row] = place
            cut[row] = tube.cut[place]
        for row in np.flatnonzero(tube.contradicted[:count]):
            slot = int(slots[row])
            if not self._falsified[slot]:
                events.append(
                    EngineEvent(
                        EventKind.DATA_CONTRADICTED,
                        self._names[slot],
                        int(t[row]),
                        "the data contradicts the stated noise or Lipschitz bounds: widen them in the profile",
                    )
                )
            self._falsified[slot] = True
        steps = tuple(_take(s, source) for s in tube.steps[1:])
        free = tuple(_take(s, free_rows) for s in tube.steps[1:])
        return steps, free, cut[:, 1:], tube.contradicted[:count]

    def _check(self, batch: SampleBatch) -> list[EngineEvent]:
        """Hold the measurements against the one-step predictions that wait for them."""
        events: list[EngineEvent] = []
        due = [
            (row, slot, *self._pending[slot][3:])
            for row, slot in enumerate(batch.vehicle.tolist())
            if slot in self._pending and self._follows(batch, row, self._pending[slot])
        ]
        if not due:
            return events
        rows = [d[0] for d in due]
        measurement = self.bounds.measurement if self.method != "calibrated" else np.zeros((self.layout.n, 0))
        held, excess = audit.inside(join_sets([d[2] for d in due]), measurement, batch.x[rows], self.layout.angles)
        free_held = held.copy()
        missed = np.flatnonzero(~held)
        if len(missed):
            free_held[missed], _ = audit.inside(
                join_sets([due[i][3] for i in missed]), measurement, batch.x[rows][missed], self.layout.angles
            )
        for i, (row, slot, _, _) in enumerate(due):
            del self._pending[slot]
            self._checked[slot] += 1
            self._inside[slot] += bool(held[i])
            if held[i]:
                continue
            self._last_miss[slot] = excess[i]
            events += self._miss(slot, int(batch.t[row]), float(excess[i]), side_information=bool(free_held[i]))
        return events

    def _follows(self, batch: SampleBatch, row: int, pending: tuple[int, int, int, FactorSet, FactorSet]) -> bool:
        epoch, seq, t = pending[:3]
        return (
            int(batch.epoch[row]) == epoch
            and int(batch.seq[row]) == seq + 1
            and not batch.flags[row] & int(StateFlag.NEW_TRAJECTORY)
            and abs(int(batch.t[row]) - t) <= self.profile.tolerance * self.profile.sample_time_ns
        )

    def _miss(self, slot: int, t: int, excess: float, *, side_information: bool) -> list[EngineEvent]:
        vehicle = self._names[slot]
        if side_information:
            return self._assignments.contradict(slot, vehicle, t, None)
        if self.method == "calibrated":
            return []
        self._falsified[slot] = True
        message = f"the measured state lay outside its predicted set by {excess:.3g}: a stated bound is wrong, widen it"
        return [EngineEvent(EventKind.MISS, vehicle, t, message, {"excess": excess})]

    def _label(self, slot: int, contradicted: bool) -> Label:
        if self.method == "calibrated":
            return Label.CALIBRATED
        if contradicted or self._falsified[slot]:
            return Label.CONTRADICTED
        noise = self.profile.noise
        if noise.process is None or noise.measurement is None or self._lipschitz is None:
            return Label.UNCOVERED
        return Label.GUARANTEED if self.profile.guaranteed else Label.CALIBRATED

    def _notes(self, slot: int) -> tuple[str, ...]:
        notes = []
        if isinstance(self._store, model.Model):
            if self._store.rank_deficient[slot]:
                notes.append("rank deficient")
            if self._lipschitz is None:
                notes.append("no Lipschitz bound")
        elif not self._planned:
            notes.append("learned driver")
        if self._assignments.contradicted(slot):
            notes.append("side information contradicted")
        return tuple(notes)

    def _refit(self, slots: NDArray[np.intp]) -> None:
        """Fit again where enough new samples have come; vehicles are spread over the ticks by their slot."""
        due = slots[~self._fitted[slots] | (self._since_fit[slots] >= REFIT_EVERY)]
        if not len(due):
            return
        block = self.window.block(due)
        if self.method == "calibrated":
            fitted: Any = calibrated.fit(block, self.profile, self.layout, self.horizon, planned=self._planned)
            features = fitted.mean.shape[1]
            enough = np.isfinite(fitted.half).all(axis=(1, 2)) & (fitted.scores >= 2 * features)
        else:
            data = transitions(block, self.layout)
            enough = data.usable.sum(axis=1) >= 2 * (1 + self.layout.regressors)
            due, data = due[enough], _take(data, np.flatnonzero(enough))
            if len(due):
                fitted = model.fit(data, self.layout, self.bounds, self._lipschitz)
            enough = np.ones(len(due), dtype=bool)
        due_rows = np.flatnonzero(enough)
        if not len(due_rows):
            return
        self._store = _scatter(self._store, due[due_rows], _take(fitted, due_rows), len(self._names))
        first = ~self._fitted[due[due_rows]]
        self._fitted[due[due_rows]] = self._ready[due[due_rows]] = True
        self._since_fit[due[due_rows]] = np.where(first, due[due_rows] % REFIT_EVERY, 0)


def _take(data: Any, rows: Any) -> Any:
    """The rows of a dataclass of arrays."""
    return type(data)(**{f.name: getattr(data, f.name)[rows] for f in fields(data)})


def join_sets(sets: list[FactorSet]) -> FactorSet:
    """Sets one below the other, with zero columns and rows where they differ in size."""
    g = max(s.generators.shape[2] for s in sets)
    rows = max(s.matrix.shape[1] for s in sets)

    def padded(array: Floats, *widths: int) -> Floats:
        return np.pad(array, [(0, 0), *((0, w - a) for w, a in zip(widths, array.shape[1:], strict=True))])

    n = sets[0].center.shape[1]
    return FactorSet(
        np.concatenate([s.center for s in sets]),
        np.concatenate([padded(s.generators, n, g) for s in sets]),
        np.concatenate([padded(s.matrix, rows, g) for s in sets]),
        np.concatenate([padded(s.offset, rows) for s in sets]),
    )


def _scatter(store: Any, slots: NDArray[np.intp], new: Any, count: int) -> Any:
    """Write the rows of a dataclass of arrays into the store of all slots, which grows as needed."""
    arrays = {}
    for f in fields(new):
        value = getattr(new, f.name)
        old = None if store is None else getattr(store, f.name)
        if old is None or len(old) < count:
            grown = np.zeros((count, *value.shape[1:]), dtype=value.dtype)
            if old is not None:
                grown[: len(old)] = old
            old = grown
        old[slots] = value
        arrays[f.name] = old
    return type(new)(**arrays)
