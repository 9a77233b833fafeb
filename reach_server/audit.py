"""Predictions held against what was measured."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fleet_bus.messages import StateFlag
from reach_server.factor_sets import FactorSet
from reach_server.regression import wrap
from reach_server.rows import take
from reach_server.sets import membership
from reach_server.sets.arrays import stack_columns
from reach_server.windows import Floats, Ints, SampleBatch


def inside(
    predicted: FactorSet, measurement: Floats, y: Floats, angles: tuple[int, ...]
) -> tuple[NDArray[np.bool_], Floats]:
    """Whether each measured state (B, n) lies in its set enlarged by ``measurement`` (n, g), and by how much it does
    not: the greatest excess over the interval hull (B,), 0 inside. Angles are compared modulo 2π."""
    generators = stack_columns(predicted.generators, measurement)
    rows = predicted.matrix.shape[1]
    matrix = np.concatenate([predicted.matrix, np.zeros((len(y), rows, measurement.shape[1]))], axis=2)
    point = y.copy()
    for i in angles:
        point[:, i] = predicted.center[:, i] + wrap(y[:, i] - predicted.center[:, i])
    found = membership.contains(predicted.center, generators, matrix, predicted.offset, point)
    half = np.abs(generators).sum(axis=-1)
    excess = np.maximum(np.abs(point - predicted.center) - half, 0.0).max(axis=-1)
    return found, np.where(found, 0.0, excess)


@dataclass(frozen=True, slots=True, eq=False)
class _Round:
    """One-step predictions of one call, a row a vehicle."""

    epoch: NDArray[np.uint64]
    seq: NDArray[np.uint64]
    t: Ints
    cut: FactorSet
    free: FactorSet


class Predictions:
    """The newest one-step prediction of every vehicle, until the sample that it was made for has come."""

    def __init__(self) -> None:
        self._rounds: dict[int, _Round] = {}
        self._next = 0
        #: Round and row of the prediction of each slot, -1 where none waits.
        self._place = np.full((0, 2), -1, dtype=np.int64)

    def keep(
        self, slots: NDArray[np.intp], epoch: NDArray[np.uint64], seq: NDArray[np.uint64], t: Ints,
        cut: FactorSet, free: FactorSet,
    ) -> None:  # fmt: skip
        """Predictions for time ``t`` (B,), made from the samples (epoch, seq) of some slots, with and without cuts."""
        missing = int(slots.max(initial=-1)) + 1 - len(self._place)
        if missing > 0:
            self._place = np.concatenate([self._place, np.full((missing, 2), -1, dtype=np.int64)])
        self._rounds[self._next] = _Round(epoch, seq, t, cut, free)
        self._place[slots, 0] = self._next
        self._place[slots, 1] = np.arange(len(slots))
        self._next += 1
        self._forget_unused()

    def check(
        self, batch: SampleBatch, slack: float, measurement: Floats, angles: tuple[int, ...]
    ) -> list[tuple[int, int, bool, float, bool]]:
        """(row of the batch, slot, inside, excess, inside without cuts) of every prediction whose sample has come.

        A sample that came sooner or later than predicted, within the ``slack``, is held against the set without cuts
        only: side information may say something else at that instant.
        """
        known = np.flatnonzero(batch.vehicle < len(self._place))
        known = known[self._place[batch.vehicle[known], 0] >= 0]
        checked: list[tuple[int, int, bool, float, bool]] = []
        for number in np.unique(self._place[batch.vehicle[known], 0]).tolist():
            made = self._rounds[number]
            rows = known[self._place[batch.vehicle[known], 0] == number]
            place = self._place[batch.vehicle[rows], 1]
            follows = (
                (batch.epoch[rows] == made.epoch[place])
                & (batch.seq[rows] == made.seq[place] + np.uint64(1))
                & (batch.flags[rows] & int(StateFlag.NEW_TRAJECTORY) == 0)
                & (np.abs(batch.t[rows] - made.t[place]) <= slack)
            )
            # A sample may come twice in one batch, from the bus and from a cache.
            _, first = np.unique(batch.vehicle[rows[follows]], return_index=True)
            rows, place = rows[follows][first], place[follows][first]
            if not len(rows):
                continue
            self._place[batch.vehicle[rows], 0] = -1
            held, excess = inside(take(made.cut, place), measurement, batch.x[rows], angles)
            free = held.copy()
            missed = np.flatnonzero(~held)
            if len(missed):
                whole = take(made.free, place[missed])
                free[missed], beyond = inside(whole, measurement, batch.x[rows[missed]], angles)
                off = batch.t[rows[missed]] != made.t[place[missed]]
                held[missed[off]], excess[missed[off]] = free[missed[off]], beyond[off]
            slots = batch.vehicle[rows].tolist()
            checked += zip(rows.tolist(), slots, held.tolist(), excess.tolist(), free.tolist(), strict=True)
        self._forget_unused()
        return checked

    def drop(self, slot: int) -> None:
        """Forget what waits for one slot."""
        if slot < len(self._place):
            self._place[slot, 0] = -1
            self._forget_unused()

    def _forget_unused(self) -> None:
        used = set(np.unique(self._place[:, 0]).tolist())
        self._rounds = {number: made for number, made in self._rounds.items() if number in used}
