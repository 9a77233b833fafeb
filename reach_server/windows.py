"""Rolling data windows of a vehicle class: the newest samples of every vehicle, in order, none double."""

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from fleet_bus.messages import StateFlag, StateSample, VehicleProfile
from reach_server.rows import take, with_room

#: Samples in a row before the newest stamp after which the newest stamp is no longer believed.
RESYNC = 3

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


@dataclass(frozen=True, slots=True, eq=False)
class SampleBatch:
    """Samples of several vehicles of one class: every array has one row per sample, in any order.

    ``vehicle`` (B,) is a slot of the window; ``t`` ns; ``x`` (B, n); ``u`` (B, m); ``flags`` as in ``StateFlag``.
    """

    vehicle: NDArray[np.intp]
    epoch: NDArray[np.uint64]
    seq: NDArray[np.uint64]
    t: Ints
    flags: NDArray[np.uint32]
    x: Floats
    u: Floats

    @classmethod
    def of(cls, slot: int, samples: list[StateSample]) -> Self:
        """Batch of one vehicle's samples."""
        return cls(
            np.full(len(samples), slot, dtype=np.intp),
            np.array([s.epoch for s in samples], dtype=np.uint64),
            np.array([s.seq for s in samples], dtype=np.uint64),
            np.array([s.t for s in samples], dtype=np.int64),
            np.array([int(s.flags) for s in samples], dtype=np.uint32),
            np.array([s.x for s in samples], dtype=np.float64),
            np.array([s.u for s in samples], dtype=np.float64),
        )

    def take(self, rows: NDArray[np.intp]) -> Self:
        """The samples of some rows."""
        taken: Self = take(self, rows)
        return taken

    @classmethod
    def join(cls, batches: list["SampleBatch"]) -> "SampleBatch":
        """All samples of several batches."""
        names = ("vehicle", "epoch", "seq", "t", "flags", "x", "u")
        return cls(*(np.concatenate([getattr(batch, name) for batch in batches]) for name in names))


@dataclass(frozen=True, slots=True, eq=False)
class Block:
    """Samples of some vehicles, oldest first: arrays (B, S, ·); ``valid`` (B, S) is False on the padding in front.

    ``angles`` of ``x`` are as received; ``linked`` (B, S) says that a sample follows the one before it: same
    epoch, next seq, no new trajectory, sample interval within the tolerance.
    """

    t: Ints
    x: Floats
    u: Floats
    valid: NDArray[np.bool_]
    input_known: NDArray[np.bool_]
    linked: NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class Appended:
    """What became of a batch: samples stored, seen before, and refused because their stamp does not advance."""

    stored: int
    repeated: int
    backwards: int


class Window:
    """Ring buffers (V, S, ·) of the newest ``S = size`` samples of V vehicles.

    Samples may come in any order and more than once: they are identified by (epoch, seq) and kept sorted by
    it. A sample whose stamp does not advance within its epoch is refused, so one bad clock reading cannot
    reorder a trajectory. When ``RESYNC`` samples in a row lie before the newest one, it is the newest one whose
    stamp was wrong, or the clock was set back: the next is taken, and begins a trajectory since the interval to it
    is none.
    """

    def __init__(self, profile: VehicleProfile, size: int | None = None) -> None:
        self.size = size or profile.window + profile.input_lags + profile.horizon + 2
        self._interval = profile.sample_time_ns
        self._slack = profile.tolerance * profile.sample_time_ns
        n, m = len(profile.state), len(profile.inputs)
        self._count = np.zeros(0, dtype=np.int64)
        #: Samples in a row that were refused because they lie before the newest one.
        self._earlier = np.zeros(0, dtype=np.int64)
        self._epoch = np.zeros((0, self.size), dtype=np.uint64)
        self._seq = np.zeros((0, self.size), dtype=np.uint64)
        self._t = np.zeros((0, self.size), dtype=np.int64)
        self._flags = np.zeros((0, self.size), dtype=np.uint32)
        self._x = np.zeros((0, self.size, n))
        self._u = np.zeros((0, self.size, m))

    def grow(self, slots: int) -> None:
        """Make room for ``slots`` vehicles; the new ones are empty."""
        for name in ("_count", "_earlier", "_epoch", "_seq", "_t", "_flags", "_x", "_u"):
            array = getattr(self, name)
            setattr(self, name, with_room(array, slots, array))

    def clear(self, slot: int) -> None:
        """Forget the samples of one vehicle."""
        self._count[slot] = self._earlier[slot] = 0

    def filled(self, slots: NDArray[np.intp]) -> Ints:
        """Samples held (B,) for some vehicles."""
        return np.minimum(self._count[slots], self.size)

    def append(self, batch: SampleBatch) -> Appended:
        """Store a batch; return what became of its samples."""
        if not len(batch.vehicle):
            return Appended(0, 0, 0)
        batch = batch.take(np.lexsort((batch.seq, batch.epoch, batch.vehicle)))
        late = self._behind(batch)
        fresh = batch.take(np.flatnonzero(~np.isin(batch.vehicle, batch.vehicle[late])))
        stored, repeated, backwards = self._append_sorted(fresh) if len(fresh.vehicle) else (0, 0, 0)
        for slot in np.unique(batch.vehicle[late]):
            counts = self._merge(int(slot), batch.take(np.flatnonzero(batch.vehicle == slot)))
            stored, repeated, backwards = (a + b for a, b in zip((stored, repeated, backwards), counts, strict=True))
        return Appended(stored, repeated, backwards)

    def _behind(self, batch: SampleBatch) -> NDArray[np.bool_]:
        """Samples (B,) that are not newer, by (epoch, seq), than the newest one stored of their vehicle."""
        newest = (self._count[batch.vehicle] - 1) % self.size
        known = self._count[batch.vehicle] > 0
        epoch, seq = self._epoch[batch.vehicle, newest], self._seq[batch.vehicle, newest]
        return np.asarray(known & ((batch.epoch < epoch) | ((batch.epoch == epoch) & (batch.seq <= seq))))

    def _append_sorted(self, batch: SampleBatch) -> tuple[int, int, int]:
        """Append samples sorted by (vehicle, epoch, seq), all newer than what is stored."""
        same = np.zeros(len(batch.vehicle), dtype=bool)
        same[1:] = (
            (batch.vehicle[1:] == batch.vehicle[:-1])
            & (batch.epoch[1:] == batch.epoch[:-1])
            & (batch.seq[1:] == batch.seq[:-1])
        )
        repeated = int(same.sum())
        batch = batch.take(np.flatnonzero(~same))
        stored = backwards = 0
        starts = np.flatnonzero(np.r_[True, batch.vehicle[1:] != batch.vehicle[:-1]])
        rank = np.arange(len(batch.vehicle)) - np.repeat(starts, np.diff(np.r_[starts, len(batch.vehicle)]))
        # One round stores at most one sample of each vehicle, so that a round is one vectorised write.
        by_round = np.argsort(rank, kind="stable")
        for rows in np.split(by_round, np.cumsum(np.bincount(rank))[:-1]):
            newest = (self._count[batch.vehicle[rows]] - 1) % self.size
            vehicle = batch.vehicle[rows]
            earlier = batch.t[rows] < self._t[vehicle, newest]
            advances = (
                (self._count[vehicle] == 0)
                | (self._epoch[vehicle, newest] != batch.epoch[rows])
                | (batch.t[rows] > self._t[vehicle, newest])
                | (earlier & (self._earlier[vehicle] >= RESYNC))
            )
            self._earlier[vehicle] = np.where(earlier & ~advances, self._earlier[vehicle] + 1, 0)
            backwards += int((~advances).sum())
            rows, vehicle = rows[advances], vehicle[advances]
            place = self._count[vehicle] % self.size
            self._epoch[vehicle, place] = batch.epoch[rows]
            self._seq[vehicle, place] = batch.seq[rows]
            self._t[vehicle, place] = batch.t[rows]
            self._flags[vehicle, place] = batch.flags[rows]
            self._x[vehicle, place] = batch.x[rows]
            self._u[vehicle, place] = batch.u[rows]
            self._count[vehicle] += 1
            stored += len(rows)
        return stored, repeated, backwards

    def _merge(self, slot: int, batch: SampleBatch) -> tuple[int, int, int]:
        """Put samples among those stored of one vehicle."""
        old = self._held(slot)
        known = set(zip(old.epoch.tolist(), old.seq.tolist(), strict=True))
        new = [
            i for i, key in enumerate(zip(batch.epoch.tolist(), batch.seq.tolist(), strict=True)) if key not in known
        ]
        repeated = len(batch.vehicle) - len(new)
        if not new:
            return 0, repeated, 0
        union = SampleBatch.join([old, batch.take(np.array(new))])
        self.clear(slot)
        stored, doubled, backwards = self._append_sorted(union.take(np.lexsort((union.seq, union.epoch))))
        return stored - len(old.vehicle), repeated + doubled, backwards

    def _held(self, slot: int) -> SampleBatch:
        order = self._order(np.array([slot]))[0]
        order = order[self.size - int(self.filled(np.array([slot]))[0]) :]
        return SampleBatch(
            np.full(len(order), slot, dtype=np.intp), self._epoch[slot, order], self._seq[slot, order],
            self._t[slot, order], self._flags[slot, order], self._x[slot, order], self._u[slot, order],
        )  # fmt: skip

    def keys(self, slot: int) -> list[tuple[int, int]]:
        """(epoch, seq) of the samples held of one vehicle, oldest first."""
        held = self._held(slot)
        return list(zip(held.epoch.tolist(), held.seq.tolist(), strict=True))

    def _order(self, slots: NDArray[np.intp]) -> NDArray[np.intp]:
        return (self._count[slots, None] + np.arange(self.size)) % self.size

    def block(self, slots: NDArray[np.intp], length: int | None = None) -> Block:
        """The newest ``length`` samples (default: all places) of some vehicles, oldest first."""
        length = length or self.size
        order = self._order(slots)[:, self.size - length :]
        rows = slots[:, None]
        valid = np.arange(length)[None] >= length - self.filled(slots)[:, None]
        epoch, seq = self._epoch[rows, order], self._seq[rows, order]
        t, flags = self._t[rows, order], self._flags[rows, order]
        linked = np.zeros(valid.shape, dtype=bool)
        linked[:, 1:] = (
            valid[:, :-1]
            & (epoch[:, 1:] == epoch[:, :-1])
            & (seq[:, 1:] == seq[:, :-1] + np.uint64(1))
            & (flags[:, 1:] & int(StateFlag.NEW_TRAJECTORY) == 0)
            & (np.abs(np.diff(t, axis=1) - self._interval) <= self._slack)
        )
        input_known = valid & (flags & int(StateFlag.INPUT_MISSING) == 0)
        return Block(t, self._x[rows, order], self._u[rows, order], valid, input_known, linked)

    def recorded(self, slots: NDArray[np.intp], length: int) -> NDArray[np.bool_]:
        """Which of the newest ``length`` samples of some vehicles (B, length) were recorded before their start."""
        order = self._order(slots)[:, self.size - length :]
        return np.asarray(self._flags[slots[:, None], order] & int(StateFlag.HISTORY) != 0)

    def newest(
        self, slots: NDArray[np.intp]
    ) -> tuple[NDArray[np.uint64], NDArray[np.uint64], Ints, NDArray[np.uint32]]:
        """(epoch, seq, t, flags) of the newest sample of each vehicle; meaningless where none is held."""
        place = (self._count[slots] - 1) % self.size
        return (
            self._epoch[slots, place],
            self._seq[slots, place],
            self._t[slots, place],
            self._flags[slots, place],
        )
