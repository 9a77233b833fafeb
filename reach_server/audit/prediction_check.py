"""Predictions checked against measurements, and how many misses a confidence explains."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.special import bdtr

from fleet_bus.messages import StateFlag
from reach_server.data.regressors import wrap
from reach_server.data.ring_buffer import GREATEST
from reach_server.data.window import SampleBatch
from reach_server.numeric.checks import stack_columns
from reach_server.numeric.slot_table import grow_rows, take_rows
from reach_server.numeric.types import FloatArray, IntArray
from reach_server.sets.kernels import membership
from reach_server.sets.raw import RawSets

#: Checks in a row that the rolling record speaks about.
RECENT = 1000
#: A band holds the number of misses with this probability, if each check misses with the one stated.
BAND = 0.99
#: Below this many checks only what leaves a much wider band, of this probability, counts.
FEW, CLEAR_BAND = 50, 0.9999


def binomial_band(checked: int, alpha: float, probability: float = BAND) -> int:
    """Most misses among ``checked`` that ``alpha`` explains, 18 of 1000 at 1 %: the smallest m with
    ``P(Binomial(checked, alpha) <= m)`` at least ``probability``."""
    return int(np.searchsorted(bdtr(np.arange(checked), checked, alpha), probability))


@lru_cache
def bands(alpha: float) -> tuple[IntArray, IntArray]:
    """By number of checks, 0 to ``RECENT``: the most misses with which a record stays inside of its band, and the most
    with which one that has left it is taken back.

    Leaving is judged by ``BAND``, below ``FEW`` checks by ``CLEAR_BAND``; it is undone at the median, so that a record
    near the edge is not reported again and again.

    One look at an honest record leaves the band with a probability of at most 1 %. Since the record is looked at after
    each check, alarms add up: simulated with independent misses at 1 %, honest records leave 0.06 times in their first
    1000 checks and 0.3 times in 10 000 later ones, and are outside 3 % of the time. Misses that cluster, and margins
    that are estimates themselves, raise that.
    """
    leaves = np.concatenate([_bands(range(FEW), alpha, CLEAR_BAND), _bands(range(FEW, RECENT + 1), alpha, BAND)])
    return leaves, _bands(range(RECENT + 1), alpha, 0.5)


def _bands(checked: range, alpha: float, probability: float) -> IntArray:
    """``binomial_band`` of each number of checks. It never falls, so each one is looked for from the one before on: a
    class with a confidence of its own must not hold up a round."""
    found, misses = np.zeros(len(checked), dtype=np.int64), 0
    for index, number in enumerate(checked):
        while misses < number and bdtr(misses, number, alpha) < probability:
            misses += 1
        found[index] = misses
    return found


def inside(
    predicted: RawSets, measurement: FloatArray, y: FloatArray, angles: tuple[int, ...]
) -> tuple[NDArray[np.bool_], FloatArray]:
    """Whether each measured state ``y`` (B, n) lies in its set enlarged by ``measurement`` (n, g): exact up to 1e-7 of
    the set; and by how much it does not (B,): the greatest excess of a component over the interval hull, in the unit of
    that component; 0 inside, and where only constraints exclude the state. Angles are compared modulo 2π."""
    generators, matrix = predicted.generators, predicted.matrix
    if measurement.shape[1]:
        generators = stack_columns(generators, measurement)
        none = np.zeros((*matrix.shape[:2], measurement.shape[1]))
        matrix = np.concatenate([matrix, none], axis=2)
    point = _turned(predicted, y, angles)
    found = membership.contains(predicted.center, generators, matrix, predicted.offset, point)
    missed = np.flatnonzero(~found)
    excess = np.zeros(len(y))
    if len(missed):
        half = np.abs(generators[missed]).sum(axis=-1)
        excess[missed] = np.maximum(np.abs(point - predicted.center)[missed] - half, 0.0).max(axis=-1)
    return found, excess


def times_as_far(predicted: RawSets, measurement: FloatArray, y: FloatArray, angles: tuple[int, ...]) -> FloatArray:
    """How many times as far from the center of its set each measured state lies as the set enlarged by ``measurement``
    reaches (B,), in the component in which that is most; arguments as for ``inside``. Infinite where the set is flat.
    """
    half = np.abs(predicted.generators).sum(axis=-1) + np.abs(measurement).sum(axis=-1)
    off = np.abs(_turned(predicted, y, angles) - predicted.center)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        return np.asarray(np.where(off > 0, off / half, 0.0).max(axis=-1))


def _turned(predicted: RawSets, y: FloatArray, angles: tuple[int, ...]) -> FloatArray:
    """The states ``y`` (B, n), angles in the turn next to the center."""
    point = y.copy()
    for i in angles:
        point[:, i] = predicted.center[:, i] + wrap(y[:, i] - predicted.center[:, i])
    return point


@dataclass(frozen=True, slots=True, eq=False)
class Checks:
    """Predictions whose sample has come, one per vehicle: ``row`` (C,) of the batch and ``slot`` (C,); ``inside`` (C,)
    and ``excess`` (C,) as the function ``inside`` has them; ``inside_free`` (C,) the same without cuts; ``times_free``
    (C,) as ``times_as_far`` of missed states without cuts, else 0."""

    row: NDArray[np.intp]
    slot: NDArray[np.intp]
    inside: NDArray[np.bool_]
    excess: FloatArray
    inside_free: NDArray[np.bool_]
    times_free: FloatArray


class SetStore:
    """The newest set of each slot: one array for all, padded with zero generators and rows, which change no set."""

    def __init__(self) -> None:
        self._store = RawSets(np.zeros((0, 0)), np.zeros((0, 0, 0)), np.zeros((0, 0, 0)), np.zeros((0, 0)))

    def put(self, slots: NDArray[np.intp], sets: RawSets, count: int) -> None:
        """Store ``sets`` (B) for some slots, all below ``count``."""
        g, rows = sets.generators.shape[2], sets.matrix.shape[1]
        old = self._store
        if count > len(old.center) or g > old.generators.shape[2] or rows > old.matrix.shape[1]:
            self._grow(max(count, len(old.center)), sets)
        store = self._store
        store.center[slots] = sets.center
        store.generators[slots, :, :g] = sets.generators
        store.generators[slots, :, g:] = 0.0
        if store.matrix.shape[1]:
            store.matrix[slots] = 0.0
            store.offset[slots] = 0.0
            store.matrix[slots, :rows, :g] = sets.matrix
            store.offset[slots, :rows] = sets.offset

    def of(self, slots: NDArray[np.intp]) -> RawSets:
        """Sets of some slots."""
        taken: RawSets = take_rows(self._store, slots)
        return taken

    def _grow(self, count: int, sets: RawSets) -> None:
        old, n = self._store, sets.center.shape[1]
        g = max(sets.generators.shape[2], old.generators.shape[2])
        rows = max(sets.matrix.shape[1], old.matrix.shape[1])
        new = RawSets(
            np.zeros((count, n)), np.zeros((count, n, g)), np.zeros((count, rows, g)), np.zeros((count, rows))
        )
        if len(old.center):
            held, (_, had_rows, had) = len(old.center), old.matrix.shape
            new.center[:held] = old.center
            new.generators[:held, :, :had] = old.generators
            new.matrix[:held, :had_rows, :had] = old.matrix
            new.offset[:held, :had_rows] = old.offset
        self._store = new


class Predictions:
    """The newest one-step prediction of every vehicle, until the sample that it was made for has come."""

    def __init__(self) -> None:
        self._waits = np.zeros(0, dtype=bool)
        #: Whether the sample that the prediction was made for has come.
        self._met = np.zeros(0, dtype=bool)
        self._epoch = np.zeros(0, dtype=np.uint64)
        self._seq = np.zeros(0, dtype=np.uint64)
        self._t = np.zeros(0, dtype=np.int64)
        self._cut = SetStore()
        self._free = SetStore()

    def keep(
        self, slots: NDArray[np.intp], epoch: NDArray[np.uint64], seq: NDArray[np.uint64], t: IntArray,
        cut: RawSets, free: RawSets,
    ) -> None:  # fmt: skip
        """Predictions for time ``t`` (B,), made from the samples (epoch, seq) of some slots, with and without cuts."""
        if not len(slots):
            return
        needed = int(slots.max()) + 1
        for name in ("_waits", "_met", "_epoch", "_seq", "_t"):
            array = getattr(self, name)
            setattr(self, name, grow_rows(array, needed, array))
        self._waits[slots], self._met[slots] = True, False
        self._epoch[slots], self._seq[slots], self._t[slots] = epoch, seq, t
        self._cut.put(slots, cut, len(self._waits))
        self._free.put(slots, free, len(self._waits))

    def check(self, batch: SampleBatch, slack: float, measurement: FloatArray, angles: tuple[int, ...]) -> Checks:
        """The checks of predictions whose measurements have come; each prediction is checked once.

        A sample that came sooner or later than predicted, within the ``slack`` (ns), is checked against the set without
        cuts only: side information may say something else at that instant.
        """
        rows = self._awaited(batch, slack)
        slots = batch.vehicle[rows]
        if not len(rows):
            none = np.zeros(0, dtype=bool)
            return Checks(rows, slots, none, np.zeros(0), none, np.zeros(0))
        self._waits[slots], self._met[slots] = False, True
        held, excess = inside(self._cut.of(slots), measurement, batch.x[rows], angles)
        free, times = held.copy(), np.zeros(len(rows))
        missed = np.flatnonzero(~held)
        if len(missed):
            whole = self._free.of(slots[missed])
            free[missed], beyond = inside(whole, measurement, batch.x[rows[missed]], angles)
            times[missed] = times_as_far(whole, measurement, batch.x[rows[missed]], angles)
            off = batch.t[rows[missed]] != self._t[slots[missed]]
            held[missed[off]], excess[missed[off]] = free[missed[off]], beyond[off]
        return Checks(rows, slots, held, excess, free, times)

    def _awaited(self, batch: SampleBatch, slack: float) -> NDArray[np.intp]:
        """Rows of the samples that predictions wait for, one per vehicle."""
        rows = np.flatnonzero(batch.vehicle < len(self._waits))
        rows = rows[self._waits[batch.vehicle[rows]]]
        slots = batch.vehicle[rows]
        follows = (
            (batch.epoch[rows] == self._epoch[slots])
            & (batch.seq[rows] == self._seq[slots] + np.uint64(1))
            & (batch.flags[rows] & int(StateFlag.NEW_TRAJECTORY) == 0)
            & (np.abs(batch.t[rows] - self._t[slots]) <= slack)
            # What is no measurement is refused, and says nothing about a set.
            & (np.abs(batch.x[rows]) <= GREATEST).all(axis=1)
        )
        # A sample may come twice in one batch, from the bus and from a cache.
        _, first = np.unique(slots[follows], return_index=True)
        return np.asarray(rows[follows][first])

    def prior(
        self, slots: NDArray[np.intp], epoch: NDArray[np.uint64], seq: NDArray[np.uint64]
    ) -> tuple[NDArray[np.intp], RawSets]:
        """Rows (K,) of the slots whose sample (epoch, seq) is the one that a prediction was made for, and what was
        predicted for them without cuts."""
        rows = np.flatnonzero(slots < len(self._met))
        of = slots[rows]
        rows = rows[self._met[of] & (self._epoch[of] == epoch[rows]) & (self._seq[of] + np.uint64(1) == seq[rows])]
        return rows, self._free.of(slots[rows])

    def withhold(self, slots: NDArray[np.intp]) -> None:
        """Keep the predictions of some slots from being checked."""
        self._waits[slots] = False

    def drop(self, slot: int) -> None:
        """Forget what was predicted for one slot."""
        if slot < len(self._waits):
            self._waits[slot] = self._met[slot] = False
