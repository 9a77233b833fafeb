"""Rolling data windows of a vehicle class: the newest samples of every vehicle, in order, none double."""

import numpy as np
from numpy.typing import NDArray

from fleet_bus.messages import StateFlag, VehicleProfile
from reach_server.data import ring_buffer as ring
from reach_server.data.leaps import Rivals
from reach_server.data.ring_buffer import ContinuityRules, Ring, Samples
from reach_server.data.samples import AppendReport, Block, Columns, SampleBatch
from reach_server.numeric.slot_table import grow_rows
from reach_server.numeric.types import FloatArray, IntArray

__all__ = ["AppendReport", "Block", "Columns", "FloatArray", "IntArray", "SampleBatch", "Window"]


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
                         measurement errors and 5 % of the greatest change in the window): stored, ``stale``; neither
                         it nor the sample after it, which makes up for two intervals, is linked to the one before
    ===================  ===============================================================================================

    A stream of which each sample agrees with the one before is stored from its ``leaps.LATE_BATCHES + leaps.RESYNC +
    1``-th batch on at the latest, and its newest sample is then the newest one held, whatever came before it: a batch
    of which none is stored as the newest adds to one of the two counts, its samples being refused, late, or repeated.

    ``count`` (V,) is the number of samples appended since a clearing, so the next goes to place ``count % size``;
    ``revision`` (V,) rises whenever what is stored changes in another way: by clearing, throwing out, a late sample, or
    gating.
    """

    def __init__(self, profile: VehicleProfile, size: int | None = None) -> None:
        self.size = size or profile.window + profile.input_lags + profile.horizon + 2
        self._rules = _rules(profile)
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

    def columns(self) -> Columns:
        """The ring buffers, as they are now."""
        stored = self._ring
        return Columns(stored.t, stored.x, stored.u, stored.run, stored.input_known, stored.gated)

    def clear(self, slot: int) -> None:
        """Forget the samples of one vehicle."""
        self.count[slot] = 0
        self._rivals.forget(slot)
        self.revision[slot] += 1

    def gate(self, slots: NDArray[np.intp], places: NDArray[np.intp]) -> None:
        """Mark the samples at ``places`` (B,) of ``slots`` (B,) as glitches, to be kept out of models; they stay so
        until they leave the window."""
        self._ring.gated[slots, places] = True
        self.revision[slots] += 1

    def filled(self, slots: NDArray[np.intp]) -> IntArray:
        """Samples held (B,) of the vehicles in ``slots`` (B,)."""
        return np.minimum(self.count[slots], self.size)

    def append(self, batch: SampleBatch) -> AppendReport:
        """Store a batch; return what became of its samples."""
        self._batch += 1
        samples = _contiguous(batch)
        late = np.zeros(len(samples.vehicle), dtype=bool)
        in_order, any_late = ring.survey(samples, self._ring, self.count, late)
        if not any_late:
            return _summary(samples, self._append(samples, in_order=in_order))
        fate = np.zeros(len(late), dtype=np.uint8)
        for slot in np.unique(samples.vehicle[late]).tolist():
            rows = np.flatnonzero(late & (samples.vehicle == slot))
            fate[rows] = self._merge(slot, _rows(samples, rows))
            won = self._won(slot, rows, samples, fate)
            late[won] = False
            fate[won] = ring.STORED
        fresh = np.flatnonzero(~late)
        fate[fresh] = self._append(_rows(samples, fresh), in_order=in_order)
        return _summary(samples, fate)

    def _won(self, slot: int, rows: NDArray[np.intp], samples: Samples, fate: NDArray[np.uint8]) -> NDArray[np.intp]:
        """Rows of late samples of one vehicle that are newer than what is stored after all: what is stored with keys
        like theirs, or later ones, is thrown out."""
        rows = rows[np.lexsort((samples.seq[rows], samples.epoch[rows]))]
        found = np.asarray(fate[rows] & ring.REFUSED, dtype=np.uint8)
        first = ring.contest(_rows(samples, rows), self._batch, found, self._rivals, self._rules.interval)
        if first < 0:
            return rows[:0]
        places, key = self._places(slot), (samples.epoch[rows[first]], samples.seq[rows[first]])
        epoch, seq = self._ring.epoch[slot, places], self._ring.seq[slot, places]
        kept = places[(epoch < key[0]) | ((epoch == key[0]) & (seq < key[1]))]
        held = Samples(np.full(len(kept), slot), *(column[slot, kept] for column in self._ring[:6]))
        gated = self._ring.gated[slot, kept]
        self.clear(slot)
        self.count[slot] = len(kept)
        ring.rebuild(held, gated, 0, self._ring, self._rules, np.zeros(len(kept), dtype=np.uint8))
        self._rivals.won[slot] = True
        return rows[first:]

    def _append(self, samples: Samples, *, in_order: bool) -> NDArray[np.uint8]:
        """Append samples newer than those stored; the fate (B,) of each."""
        order = None if in_order else np.lexsort((samples.seq, samples.epoch, samples.vehicle))
        fate = np.zeros(len(samples.vehicle), dtype=np.uint8)
        ring.append(
            samples if order is None else _rows(samples, order), self._batch, self._ring, self.count, self._rivals,
            self._rules, fate,
        )  # fmt: skip
        if order is not None:
            fate[order] = fate.copy()
        return fate

    def _merge(self, slot: int, samples: Samples) -> NDArray[np.uint8]:
        """Put samples among those stored of one vehicle; the fate (B,) of each."""
        places = self._places(slot)
        held = Samples(np.full(len(places), slot), *(column[slot, places] for column in self._ring[:6]))
        union = Samples._make([np.concatenate([a, b]) for a, b in zip(held, samples, strict=True)])
        gated = np.r_[self._ring.gated[slot, places], np.zeros(len(samples.vehicle), dtype=bool)]
        # A stable order: of samples with the same key, those held come first, then those that came first.
        order = np.lexsort((union.seq, union.epoch))
        fate = np.zeros(len(order), dtype=np.uint8)
        ring.fit_in(_rows(union, order), order < len(places), fate)
        kept = np.flatnonzero(fate == ring.STORED)
        gone = kept[: max(len(kept) - self.size, 0)]
        fate[gone[order[gone] >= len(places)]] = ring.TOO_OLD
        added = int((fate[order >= len(places)] == ring.STORED).sum())
        if added:
            self.count[slot] += added
            self.revision[slot] += 1
            newest = order[kept[len(gone) :]]
            start = int(self.count[slot]) - len(newest)
            found = np.zeros(len(newest), dtype=np.uint8)
            ring.rebuild(_rows(union, newest), gated[newest], start, self._ring, self._rules, found)
            fate[kept[len(gone) :]] |= found
        result = np.zeros(len(samples.vehicle), dtype=np.uint8)
        came = order >= len(places)
        result[order[came] - len(places)] = fate[came]
        return result

    def _places(self, slot: int) -> NDArray[np.intp]:
        """Places of the samples held of one vehicle, oldest first."""
        count = int(self.count[slot])
        return np.arange(max(count - self.size, 0), count) % self.size

    def followed(self, slots: NDArray[np.intp]) -> NDArray[np.bool_]:
        """Whether the newest sample of the vehicles in ``slots`` (B,) follows the one before it, or is the only one
        held: (B,)."""
        place = (self.count[slots] - 1) % self.size
        return np.asarray((self.count[slots] == 1) | (self._ring.run[slots, place] > 0))

    def keys(self, slot: int) -> list[tuple[int, int]]:
        """(epoch, seq) of the samples held of one vehicle, oldest first."""
        places = self._places(slot)
        epoch, seq = self._ring.epoch[slot, places], self._ring.seq[slot, places]
        return list(zip(epoch.tolist(), seq.tolist(), strict=True))

    def _newest_places(self, slots: NDArray[np.intp], length: int) -> NDArray[np.intp]:
        return (self.count[slots, None] + np.arange(-length, 0)) % self.size

    def block(self, slots: NDArray[np.intp], length: int | None = None) -> Block:
        """The newest ``length`` samples (default: all places) of the vehicles in ``slots`` (B,), oldest first."""
        length = length or self.size
        places = self._newest_places(slots, length)
        rows = slots[:, None]
        valid = np.arange(length)[None] >= length - self.filled(slots)[:, None]
        linked = np.zeros(valid.shape, dtype=bool)
        linked[:, 1:] = valid[:, :-1] & (self._ring.run[rows, places[:, 1:]] > 0)
        stored = self._ring
        return Block(
            stored.t[rows, places], stored.x[rows, places], stored.u[rows, places], valid,
            valid & stored.input_known[rows, places], linked,
        )  # fmt: skip

    def recorded(self, slots: NDArray[np.intp], length: int) -> NDArray[np.bool_]:
        """Which of the newest ``length`` samples of the vehicles in ``slots`` (B,) were recorded before their start:
        (B, length)."""
        flags = self._ring.flags[slots[:, None], self._newest_places(slots, length)]
        return np.asarray(flags & int(StateFlag.HISTORY) != 0)

    def stray(self, slots: NDArray[np.intp], length: int) -> NDArray[np.bool_]:
        """Which of the newest ``length`` samples of the vehicles in ``slots`` (B,) stand alone, (B, length): they came
        right after another one, but their pose does not follow from its, nor the next one's from theirs."""
        length = min(length, self.size - 1)
        rows, places = slots[:, None], self._newest_places(slots, length + 1)
        run, stored = self._ring.run[rows, places], self._ring
        alone = run[:, 1:] == 0
        alone[:, :-1] &= run[:, 2:] == 0
        alone &= np.arange(length)[None] > length - self.filled(slots)[:, None]
        if alone.any():
            epoch, seq, t = stored.epoch[rows, places], stored.seq[rows, places], stored.t[rows, places]
            alone &= (epoch[:, 1:] == epoch[:, :-1]) & (seq[:, 1:] == seq[:, :-1] + np.uint64(1))
            alone &= np.abs(np.diff(t, axis=1) - self._rules.interval) <= self._rules.slack
            alone &= stored.flags[rows, places[:, 1:]] & int(StateFlag.NEW_TRAJECTORY) == 0
        return np.asarray(alone)

    def newest(
        self, slots: NDArray[np.intp]
    ) -> tuple[NDArray[np.uint64], NDArray[np.uint64], IntArray, NDArray[np.uint32]]:
        """(epoch, seq, t, flags), each (B,), of the newest sample of the vehicles in ``slots`` (B,); meaningless where
        none is held."""
        place = (self.count[slots] - 1) % self.size
        stored = self._ring
        return stored.epoch[slots, place], stored.seq[slots, place], stored.t[slots, place], stored.flags[slots, place]


def _rules(profile: VehicleProfile) -> ContinuityRules:
    """What a profile says about the changes of its states."""
    states, roles = list(profile.state.values()), profile.roles
    top = np.array([np.inf if spec.rate is None else spec.rate for spec in states])
    error = np.zeros(len(states))
    if profile.noise.measurement is not None:
        error = np.abs(profile.noise.measurement.matrix()).sum(axis=1)
    named = roles.position is not None
    first, second = profile.position if named else (-1, -1)
    speed = -1 if roles.speed is None else profile.state_names.index(roles.speed)
    pose = np.ones(len(states), dtype=bool)
    if named:
        pose = np.isin(np.arange(len(states)), [first, second, -1 if profile.heading is None else profile.heading])
        allowed = np.hypot(top[first], top[second])
        limits = states[speed].limits if speed >= 0 else None
        if limits is not None and speed not in (first, second):
            allowed = min(allowed, max(abs(limits[0]), abs(limits[1])))
        top[[first, second]] = allowed
        error[[first, second]] = np.hypot(error[first], error[second])
    return ContinuityRules(
        profile.sample_time_ns, profile.tolerance * profile.sample_time_ns, profile.angles, pose, top, 2 * error,
        first, second, speed,
    )  # fmt: skip


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


def _summary(samples: Samples, fate: NDArray[np.uint8]) -> AppendReport:
    if not fate.any():
        return AppendReport(len(fate), fate=fate)
    counts = np.bincount(fate & ring.REFUSED, minlength=ring.LEAP + 1).tolist()
    no_input, stale, again = (int((fate & mark != 0).sum()) for mark in (ring.NO_INPUT, ring.STALE, ring.RESYNCED))
    jumped = np.flatnonzero(fate & ring.JUMPED)
    named = zip(samples.vehicle[jumped].tolist(), samples.t[jumped].tolist(), strict=True)
    return AppendReport(
        counts[ring.STORED], counts[ring.REPEATED], counts[ring.BACKWARDS], counts[ring.STOPPED],
        counts[ring.NOT_FINITE], counts[ring.TOO_OLD], no_input, stale, again, tuple(named), counts[ring.LEAP], fate,
    )  # fmt: skip
