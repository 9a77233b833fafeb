"""Rolling data windows of a vehicle class: the newest samples of every vehicle, in order and without duplicates."""

import numpy as np
from numpy.typing import NDArray

from fleet_bus.messages import StateFlag, VehicleProfile
from reach_server.data import ring_buffer as ring
from reach_server.data.pose_jumps import rules_of
from reach_server.data.ring_buffer import Ring, Samples
from reach_server.data.samples import AppendReport, Block, SampleArrays, SampleBatch
from reach_server.data.stream_order import Rivals
from reach_server.numeric.slot_table import grow_rows
from reach_server.numeric.types import FloatArray, IntArray

__all__ = ["AppendReport", "Block", "FloatArray", "IntArray", "SampleArrays", "SampleBatch", "Window"]


class Window:
    """Ring buffers (V, S, ·) of the newest ``S = size`` samples of V vehicles.

    Samples may come in any order and more than once: they are identified by (epoch, seq) and kept sorted by it. A
    sample follows the one before it, is *linked* to it, if it has the same epoch and the next seq, begins no new
    trajectory, and comes a sample interval later within the profile's tolerance. What else can come, and what happens
    then, whatever has come before; ``leaps`` has the numbers:

    ===================  ===============================================================================================
    state not a number   NaN, infinite or above 1e30: refused, ``not_finite``; the gap begins a trajectory
    input not a number   stored without input (``INPUT_MISSING``), ``no_input``
    key seen before      refused, ``repeated``: the values that came first count
    late sample          put in its place by (epoch, seq) if its stamp fits there (else ``backwards`` or ``stopped``)
                         and the window still reaches back to it (else ``too_old``)
    stamp repeated       equal to the newest one of its epoch: refused, ``stopped``
    stamp backwards      before the newest one of its epoch: refused, ``backwards``; so one bad clock reading cannot
                         reorder a trajectory
    number leaps         ahead of the newest one by more than 10 samples and 10 times what the stamps say, in sample
                         times: refused, ``leaped``
    stamp leaps          ahead of the newest one by more than 10 sample times and 10 times what the numbers say, unless
                         the sample says that a trajectory begins, or recorded history ends; or above 2**62 ns:
                         refused, ``leaped``
    epoch leaps          newer than the newest one, but greater than the stamp, or with a stamp not after the newest
                         one; or older, with a stamp not before what the newer one has begun with: refused, ``leaped``
    sample believed      after three refused in a row that agree with each other (the same epoch, numbers and stamps
                         that rise and do not leap) the fourth is stored and begins a trajectory, ``resynced``. Nothing
                         newer may have been stored meanwhile: then what is stored goes on, and the count begins anew
    late ones believed   the same where all that comes for 20 batches in a row is late or repeated, and agrees
    what is thrown out   samples with the key of the first that is believed, or a later one: only they were wrong
    pose jumps           stored, begins a trajectory, ``jumped``. A state jumps where it changes by more than twice what
                         its ``rate`` allows (positions: what the limits of the speed allow). The pose of a vehicle that
                         states neither (every state where no role names the pose) jumps where it changes by more
                         than 10 times every change between linked samples in the window, with 50 of them, and
                         positions by 3 times what the speed says. Two measurement errors are granted in addition.
    pose repeated        position bitwise the one before, although the speed says that it moves (by more than two
                         measurement errors and 5 % of the greatest change in the window): stored, ``frozen_pose``;
                         neither it nor the next sample, which makes up for two intervals, is linked to the one before
    ===================  ===============================================================================================

    A stream of which each sample agrees with the one before is stored from its ``leaps.LATE_BATCHES + leaps.RESYNC +
    1``-th batch on at the latest, and its newest sample is then the newest one held, whatever came before it: a batch
    of which none is stored as the newest adds to one of the two counts, its samples being refused, late, or repeated.

    ``count`` (V,) is the number of samples appended since a clearing, so the next goes to index ``count % size``;
    ``revision`` (V,) rises whenever what is stored changes in another way: by clearing, throwing out, a late sample, or
    gating.
    """

    def __init__(self, profile: VehicleProfile, size: int | None = None) -> None:
        self.size = size or profile.window + profile.input_lags + profile.horizon + 2
        self._rules = rules_of(profile)
        n, m = len(profile.state), len(profile.inputs)
        self.count = np.zeros(0, dtype=np.int64)
        self.revision = np.zeros(0, dtype=np.int64)
        self._rivals = Rivals.none()
        #: Number of the batch that is being stored.
        self._batch = 0
        shape = (0, self.size)
        self._ring = Ring(
            np.zeros(shape, dtype=np.uint64), np.zeros(shape, dtype=np.uint64), np.zeros(shape, dtype=np.int64),
            np.zeros(shape, dtype=np.uint32), np.zeros((*shape, n)), np.zeros((*shape, m)),
            np.zeros(shape, dtype=np.int32), np.zeros(shape, dtype=bool), np.zeros(shape, dtype=bool),
        )  # fmt: skip

    def grow(self, slots: int) -> None:
        """Make room for ``slots`` vehicles; the new ones are empty."""
        for name in ("count", "revision"):
            array = getattr(self, name)
            setattr(self, name, grow_rows(array, slots, array))
        self._rivals = Rivals(*(grow_rows(column, slots, column) for column in self._rivals))
        self._ring = Ring(*(grow_rows(column, slots, column) for column in self._ring))

    def arrays(self) -> SampleArrays:
        """The ring buffers, as they are now."""
        stored = self._ring
        return SampleArrays(stored.t, stored.x, stored.u, stored.run, stored.input_known, stored.gated)

    def clear(self, slot: int) -> None:
        """Forget the samples of one vehicle."""
        self.count[slot] = 0
        self._rivals.forget(slot)
        self.revision[slot] += 1

    def gate(self, slots: NDArray[np.intp], indices: NDArray[np.intp]) -> None:
        """Mark the samples at ``indices`` (B,) of ``slots`` (B,) as glitches, to be kept out of models; they stay so
        until they leave the window."""
        self._ring.gated[slots, indices] = True
        self.revision[slots] += 1

    def filled(self, slots: NDArray[np.intp]) -> IntArray:
        """Samples held (B,) of the vehicles in ``slots`` (B,)."""
        return np.minimum(self.count[slots], self.size)

    def append(self, batch: SampleBatch) -> AppendReport:
        """Store a batch; return how many of its samples were stored or refused, and why."""
        self._batch += 1
        samples = _contiguous(batch)
        late = np.zeros(len(samples.vehicle), dtype=bool)
        in_order, any_late = ring.scan(samples, self._ring, self.count, late)
        if not any_late:
            return _summary(samples, self._append(samples, in_order=in_order))
        status = np.zeros(len(late), dtype=np.uint8)
        for slot in np.unique(samples.vehicle[late]).tolist():
            rows = np.flatnonzero(late & (samples.vehicle == slot))
            status[rows] = self._merge(slot, _rows(samples, rows))
            won = self._won(slot, rows, samples, status)
            late[won] = False
            status[won] = ring.STORED
        fresh = np.flatnonzero(~late)
        status[fresh] = self._append(_rows(samples, fresh), in_order=in_order)
        return _summary(samples, status)

    def _won(self, slot: int, rows: NDArray[np.intp], samples: Samples, status: NDArray[np.uint8]) -> NDArray[np.intp]:
        """Rows of late samples of one vehicle that are newer than what is stored after all: what is stored with keys
        like theirs, or later ones, is thrown out."""
        rows = rows[np.lexsort((samples.seq[rows], samples.epoch[rows]))]
        found = np.asarray(status[rows] & ring.REFUSED, dtype=np.uint8)
        first = ring.contest(_rows(samples, rows), self._batch, found, self._rivals, self._rules.interval)
        if first < 0:
            return rows[:0]
        indices, key = self._indices(slot), (samples.epoch[rows[first]], samples.seq[rows[first]])
        epoch, seq = self._ring.epoch[slot, indices], self._ring.seq[slot, indices]
        retained = indices[(epoch < key[0]) | ((epoch == key[0]) & (seq < key[1]))]
        held = Samples(np.full(len(retained), slot), *(column[slot, retained] for column in self._ring[:6]))
        gated = self._ring.gated[slot, retained]
        self.clear(slot)
        self.count[slot] = len(retained)
        ring.rebuild(held, gated, 0, self._ring, self._rules, np.zeros(len(retained), dtype=np.uint8))
        self._rivals.won[slot] = True
        return rows[first:]

    def _append(self, samples: Samples, *, in_order: bool) -> NDArray[np.uint8]:
        """Append samples newer than those stored; the status (B,) of each."""
        order = None if in_order else np.lexsort((samples.seq, samples.epoch, samples.vehicle))
        status = np.zeros(len(samples.vehicle), dtype=np.uint8)
        ring.append(
            samples if order is None else _rows(samples, order), self._batch, self._ring, self.count, self._rivals,
            self._rules, status,
        )  # fmt: skip
        if order is not None:
            status[order] = status.copy()
        return status

    def _merge(self, slot: int, samples: Samples) -> NDArray[np.uint8]:
        """Put samples among those stored of one vehicle; the status (B,) of each."""
        indices = self._indices(slot)
        held = Samples(np.full(len(indices), slot), *(column[slot, indices] for column in self._ring[:6]))
        union = Samples._make([np.concatenate([a, b]) for a, b in zip(held, samples, strict=True)])
        gated = np.r_[self._ring.gated[slot, indices], np.zeros(len(samples.vehicle), dtype=bool)]
        # A stable order: of samples with the same key, those held come first, then those that came first.
        order = np.lexsort((union.seq, union.epoch))
        status = np.zeros(len(order), dtype=np.uint8)
        ring.fit_in(_rows(union, order), order < len(indices), status)
        retained = np.flatnonzero(status == ring.STORED)
        evicted = retained[: max(len(retained) - self.size, 0)]
        status[evicted[order[evicted] >= len(indices)]] = ring.TOO_OLD
        added = int((status[order >= len(indices)] == ring.STORED).sum())
        if added:
            self.count[slot] += added
            self.revision[slot] += 1
            newest = order[retained[len(evicted) :]]
            start = int(self.count[slot]) - len(newest)
            found = np.zeros(len(newest), dtype=np.uint8)
            ring.rebuild(_rows(union, newest), gated[newest], start, self._ring, self._rules, found)
            status[retained[len(evicted) :]] |= found
        result = np.zeros(len(samples.vehicle), dtype=np.uint8)
        came = order >= len(indices)
        result[order[came] - len(indices)] = status[came]
        return result

    def _indices(self, slot: int) -> NDArray[np.intp]:
        """Indices of the samples held of one vehicle, oldest first."""
        count = int(self.count[slot])
        return np.arange(max(count - self.size, 0), count) % self.size

    def followed(self, slots: NDArray[np.intp]) -> NDArray[np.bool_]:
        """Whether the newest sample of the vehicles in ``slots`` (B,) follows the one before it, or is the only one
        held: (B,)."""
        index = (self.count[slots] - 1) % self.size
        return np.asarray((self.count[slots] == 1) | (self._ring.run[slots, index] > 0))

    def keys(self, slot: int) -> list[tuple[int, int]]:
        """(epoch, seq) of the samples held of one vehicle, oldest first."""
        indices = self._indices(slot)
        epoch, seq = self._ring.epoch[slot, indices], self._ring.seq[slot, indices]
        return list(zip(epoch.tolist(), seq.tolist(), strict=True))

    def _newest_indices(self, slots: NDArray[np.intp], length: int) -> NDArray[np.intp]:
        return (self.count[slots, None] + np.arange(-length, 0)) % self.size

    def block(self, slots: NDArray[np.intp], length: int | None = None) -> Block:
        """The newest ``length`` samples (default: all that fit) of the vehicles in ``slots`` (B,), oldest first."""
        length = length or self.size
        indices = self._newest_indices(slots, length)
        rows = slots[:, None]
        valid = np.arange(length)[None] >= length - self.filled(slots)[:, None]
        linked = np.zeros(valid.shape, dtype=bool)
        linked[:, 1:] = valid[:, :-1] & (self._ring.run[rows, indices[:, 1:]] > 0)
        stored = self._ring
        return Block(
            stored.t[rows, indices], stored.x[rows, indices], stored.u[rows, indices], valid,
            valid & stored.input_known[rows, indices], linked,
        )  # fmt: skip

    def recorded(self, slots: NDArray[np.intp], length: int) -> NDArray[np.bool_]:
        """Which of the newest ``length`` samples of the vehicles in ``slots`` (B,) were recorded before their start:
        (B, length)."""
        flags = self._ring.flags[slots[:, None], self._newest_indices(slots, length)]
        return np.asarray(flags & int(StateFlag.HISTORY) != 0)

    def stray(self, slots: NDArray[np.intp], length: int) -> NDArray[np.bool_]:
        """Which of the newest ``length`` samples of the vehicles in ``slots`` (B,) stand alone, (B, length): they came
        right after another one, but their pose does not follow from its, nor the next one's from theirs."""
        length = min(length, self.size - 1)
        rows, indices = slots[:, None], self._newest_indices(slots, length + 1)
        run, stored = self._ring.run[rows, indices], self._ring
        alone = run[:, 1:] == 0
        alone[:, :-1] &= run[:, 2:] == 0
        alone &= np.arange(length)[None] > length - self.filled(slots)[:, None]
        if alone.any():
            epoch, seq, t = stored.epoch[rows, indices], stored.seq[rows, indices], stored.t[rows, indices]
            alone &= (epoch[:, 1:] == epoch[:, :-1]) & (seq[:, 1:] == seq[:, :-1] + np.uint64(1))
            alone &= np.abs(np.diff(t, axis=1) - self._rules.interval) <= self._rules.slack
            alone &= stored.flags[rows, indices[:, 1:]] & int(StateFlag.NEW_TRAJECTORY) == 0
        return np.asarray(alone)

    def newest(
        self, slots: NDArray[np.intp]
    ) -> tuple[NDArray[np.uint64], NDArray[np.uint64], IntArray, NDArray[np.uint32]]:
        """(epoch, seq, t, flags), each (B,), of the newest sample of the vehicles in ``slots`` (B,); meaningless where
        none is held."""
        index = (self.count[slots] - 1) % self.size
        stored = self._ring
        return stored.epoch[slots, index], stored.seq[slots, index], stored.t[slots, index], stored.flags[slots, index]


def _contiguous(batch: SampleBatch) -> Samples:
    # Kernels are compiled once, for writable contiguous arrays.
    return Samples(
        np.require(batch.vehicle, np.int64, ("C", "W")), np.require(batch.epoch, np.uint64, ("C", "W")),
        np.require(batch.seq, np.uint64, ("C", "W")), np.require(batch.t, np.int64, ("C", "W")),
        np.require(batch.flags, np.uint32, ("C", "W")), np.require(batch.x, np.float64, ("C", "W")),
        np.require(batch.u, np.float64, ("C", "W")),
    )  # fmt: skip


def _rows(samples: Samples, rows: NDArray[np.intp]) -> Samples:
    return Samples._make([column[rows] for column in samples])


def _summary(samples: Samples, status: NDArray[np.uint8]) -> AppendReport:
    if not status.any():
        return AppendReport(len(status), status=status)
    counts = np.bincount(status & ring.REFUSED, minlength=ring.LEAP + 1).tolist()
    no_input, frozen, again = (int((status & mark != 0).sum()) for mark in (ring.NO_INPUT, ring.FROZEN, ring.RESYNCED))
    jumped = np.flatnonzero(status & ring.JUMPED)
    named = zip(samples.vehicle[jumped].tolist(), samples.t[jumped].tolist(), strict=True)
    return AppendReport(
        counts[ring.STORED], counts[ring.REPEATED], counts[ring.BACKWARDS], counts[ring.STOPPED],
        counts[ring.NOT_FINITE], counts[ring.TOO_OLD], no_input, frozen, again, tuple(named), counts[ring.LEAP], status,
    )  # fmt: skip
