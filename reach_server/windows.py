"""Rolling data windows of a vehicle class: the newest samples of every vehicle, in order, none double."""

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from fleet_bus.messages import StateFlag, StateSample, VehicleProfile
from reach_server import ring
from reach_server.ring import Ring, Rules, Samples
from reach_server.rows import take, with_room

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


@dataclass(frozen=True, slots=True, eq=False)
class SampleBatch:
    """B samples of several vehicles of one class: every array has one row per sample, in any order.

    Attributes:
        vehicle: (B,) slots of the window, see ``Engine.add``.
        epoch, seq: (B,) which sample of the vehicle it is.
        t: (B,) stamps, ns since the Unix epoch.
        flags: (B,) see ``StateFlag``.
        x: (B, n) states, in the units of the profile.
        u: (B, m) inputs in force from ``t`` on, in the units of the profile; NaN where not known.
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
        """The samples of some ``rows`` (K,)."""
        taken: Self = take(self, rows)
        return taken

    @classmethod
    def join(cls, batches: list["SampleBatch"]) -> "SampleBatch":
        """All samples of several batches."""
        names = ("vehicle", "epoch", "seq", "t", "flags", "x", "u")
        return cls(*(np.concatenate([getattr(batch, name) for batch in batches]) for name in names))


@dataclass(frozen=True, slots=True, eq=False)
class Block:
    """S samples of each of B vehicles, oldest first.

    ``t`` (B, S) ns, ``x`` (B, S, n) as received, ``u`` (B, S, m) zero where ``input_known`` (B, S) is False; ``valid``
    (B, S) is False on the padding in front. ``linked`` (B, S) says that a sample follows the one before it: same epoch,
    next seq, no new trajectory, sample interval within the tolerance.
    """

    t: Ints
    x: Floats
    u: Floats
    valid: NDArray[np.bool_]
    input_known: NDArray[np.bool_]
    linked: NDArray[np.bool_]


@dataclass(frozen=True, slots=True, eq=False)
class Columns:
    """The ring buffers themselves, a row a slot: the sample of place p is ``t[slot, p]``, ``x[slot, p]`` and so on.

    ``t`` (V, S) ns; ``x`` (V, S, n) as received; ``u`` (V, S, m), zero where not known; ``run`` (V, S) number of links
    that end at a sample, 0 where a trajectory begins (links to samples that have left the window count: go no further
    back than the window does); ``input_known`` (V, S); ``gated`` (V, S) set by ``Window.gate``: a glitch, to be kept
    out of models. What stands at places that hold no sample means nothing. To be read, and not to be kept: growing
    makes new arrays.
    """

    t: Ints
    x: Floats
    u: Floats
    run: NDArray[np.int32]
    input_known: NDArray[np.bool_]
    gated: NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class Appended:
    """What became of the samples of a batch.

    Each was stored, or refused: seen before (``repeated``), stamp before the newest one (``backwards``) or equal to it
    (``stopped``), a state that is no number (``not_finite``), older than all that a full window holds (``too_old``).
    Of those stored, ``no_input`` had an input that is no number, ``stale`` repeated a pose while moving, ``resynced``
    set the clock back, and ``jumped`` names (slot, t) of those whose pose jumped.
    """

    stored: int = 0
    repeated: int = 0
    backwards: int = 0
    stopped: int = 0
    not_finite: int = 0
    too_old: int = 0
    no_input: int = 0
    stale: int = 0
    resynced: int = 0
    jumped: tuple[tuple[int, int], ...] = ()

    @property
    def refused(self) -> int:
        """Samples that nobody has seen before and that are kept out."""
        return self.backwards + self.stopped + self.not_finite


class Window:
    """Ring buffers (V, S, ·) of the newest ``S = size`` samples of V vehicles.

    Samples may come in any order and more than once: they are identified by (epoch, seq) and kept sorted by it. A
    sample follows the one before it, is *linked* to it, if it has the same epoch and the next seq, begins no new
    trajectory, and comes a sample interval later within the profile's tolerance. What else can come:

    ===================  ===============================================================================================
    state not a number   NaN, infinite or above 1e30: refused, ``not_finite``; the gap begins a trajectory
    input not a number   stored without input (``INPUT_MISSING``), ``no_input``
    key seen before      refused, ``repeated``: the values that came first count
    late sample          put in its place by (epoch, seq) if its stamp fits there (else ``backwards`` or ``stopped``)
                         and the window still reaches back to it (else ``too_old``)
    stamp repeated       equal to the newest one of its epoch: refused, ``stopped``, however often it comes
    stamp backwards      before the newest one of its epoch: refused, ``backwards``; so one bad clock reading cannot
                         reorder a trajectory
    clock set back       after three in a row that lie before the newest stamp it is that stamp which was wrong, or the
                         clock was set back: the next is taken and begins a trajectory, ``resynced``
    clock set forward    stored, begins a trajectory since the interval is none
    epoch set back       samples of an older epoch than the newest one are late samples; when nothing else has come 20
                         times in a row, the vehicle was started anew with its clock set back: its window is cleared
                         and begins with that epoch, ``resynced``
    pose jumps           stored, begins a trajectory, ``jumped``. A state jumps where it changes by more than twice what
                         its ``rate`` allows (positions: what the limits of the speed allow). The pose of a vehicle that
                         states neither (every state where no role names the pose) jumps where it changes by more
                         than 10 times every change between linked samples in the window, with 50 of them, and
                         positions by 3 times what the speed says. Two measurement errors are granted in addition.
    pose repeated        position bitwise the one before, although the speed says that it moves (by more than two
                         measurement errors and 5 % of the greatest change in the window): stored, ``stale``; neither
                         it nor the sample after it, which makes up for two intervals, is linked to the one before
    ===================  ===============================================================================================

    ``count`` (V,) is the number of samples ever appended, so the next goes to place ``count % size``; ``revision`` (V,)
    rises whenever what is stored changes in another way: by clearing, a late sample, or gating.
    """

    def __init__(self, profile: VehicleProfile, size: int | None = None) -> None:
        self.size = size or profile.window + profile.input_lags + profile.horizon + 2
        self._rules = _rules(profile)
        n, m = len(profile.state), len(profile.inputs)
        self.count = np.zeros(0, dtype=np.int64)
        self.revision = np.zeros(0, dtype=np.int64)
        #: Samples in a row that were refused because they lie before the newest one.
        self._earlier = np.zeros(0, dtype=np.int64)
        #: Batches in a row with samples of an older epoch and none of the newest.
        self._older = np.zeros(0, dtype=np.int64)
        shape = (0, self.size)
        self._ring = Ring(
            np.zeros(shape, dtype=np.uint64), np.zeros(shape, dtype=np.uint64), np.zeros(shape, dtype=np.int64),
            np.zeros(shape, dtype=np.uint32), np.zeros((*shape, n)), np.zeros((*shape, m)),
            np.zeros(shape, dtype=np.int32), np.zeros(shape, dtype=bool), np.zeros(shape, dtype=bool),
        )  # fmt: skip

    def grow(self, slots: int) -> None:
        """Make room for ``slots`` vehicles; the new ones are empty."""
        for name in ("count", "revision", "_earlier", "_older"):
            array = getattr(self, name)
            setattr(self, name, with_room(array, slots, array))
        self._ring = Ring(*(with_room(column, slots, column) for column in self._ring))

    def columns(self) -> Columns:
        """The ring buffers, as they are now."""
        stored = self._ring
        return Columns(stored.t, stored.x, stored.u, stored.run, stored.input_known, stored.gated)

    def clear(self, slot: int) -> None:
        """Forget the samples of one vehicle."""
        self.count[slot] = self._earlier[slot] = self._older[slot] = 0
        self.revision[slot] += 1

    def gate(self, slots: NDArray[np.intp], places: NDArray[np.intp]) -> None:
        """Mark the samples at ``places`` (B,) of ``slots`` (B,) as glitches, to be kept out of models; they stay so
        until they leave the window."""
        self._ring.gated[slots, places] = True
        self.revision[slots] += 1

    def filled(self, slots: NDArray[np.intp]) -> Ints:
        """Samples held (B,) of the vehicles in ``slots`` (B,)."""
        return np.minimum(self.count[slots], self.size)

    def append(self, batch: SampleBatch) -> Appended:
        """Store a batch; return what became of its samples."""
        samples = _contiguous(batch)
        late = np.zeros(len(samples.vehicle), dtype=bool)
        in_order, any_late = ring.survey(samples, self._ring, self.count, self._older, late)
        if not any_late:
            return _summary(samples, self._append(samples, in_order=in_order))
        fate = np.zeros(len(late), dtype=np.uint8)
        for slot in np.unique(samples.vehicle[late]).tolist():
            rows = np.flatnonzero(late & (samples.vehicle == slot))
            if self._starts_anew(slot, samples.epoch[rows]):
                late[rows] = False
                fate[rows[0]] = ring.RESYNCED
            else:
                fate[rows] = self._merge(slot, _rows(samples, rows))
        fresh = np.flatnonzero(~late)
        fate[fresh] |= self._append(_rows(samples, fresh), in_order=in_order)
        return _summary(samples, fate)

    def _starts_anew(self, slot: int, epochs: NDArray[np.uint64]) -> bool:
        """Whether an older epoch, of some late samples, is the one that is alive; the window is cleared then."""
        newest = self._ring.epoch[slot, (self.count[slot] - 1) % self.size]
        if (epochs >= newest).any():
            return False
        self._older[slot] += 1
        if self._older[slot] <= ring.OLDER_EPOCH:
            return False
        self.clear(slot)
        return True

    def _append(self, samples: Samples, *, in_order: bool) -> NDArray[np.uint8]:
        """Append samples newer than those stored; the fate (B,) of each."""
        order = None if in_order else np.lexsort((samples.seq, samples.epoch, samples.vehicle))
        fate = np.zeros(len(samples.vehicle), dtype=np.uint8)
        ring.append(
            samples if order is None else _rows(samples, order),
            self._ring,
            self.count,
            self._earlier,
            self._rules,
            fate,
        )
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

    def newest(
        self, slots: NDArray[np.intp]
    ) -> tuple[NDArray[np.uint64], NDArray[np.uint64], Ints, NDArray[np.uint32]]:
        """(epoch, seq, t, flags), each (B,), of the newest sample of the vehicles in ``slots`` (B,); meaningless where
        none is held."""
        place = (self.count[slots] - 1) % self.size
        stored = self._ring
        return stored.epoch[slots, place], stored.seq[slots, place], stored.t[slots, place], stored.flags[slots, place]


def _rules(profile: VehicleProfile) -> Rules:
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
    return Rules(
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


def _summary(samples: Samples, fate: NDArray[np.uint8]) -> Appended:
    if not fate.any():
        return Appended(len(fate))
    counts = np.bincount(fate & ring.REFUSED, minlength=ring.TOO_OLD + 1).tolist()
    no_input, stale, again = (int((fate & mark != 0).sum()) for mark in (ring.NO_INPUT, ring.STALE, ring.RESYNCED))
    jumped = np.flatnonzero(fate & ring.JUMPED)
    named = zip(samples.vehicle[jumped].tolist(), samples.t[jumped].tolist(), strict=True)
    return Appended(
        counts[ring.STORED], counts[ring.REPEATED], counts[ring.BACKWARDS], counts[ring.STOPPED],
        counts[ring.NOT_FINITE], counts[ring.TOO_OLD], no_input, stale, again, tuple(named),
    )  # fmt: skip
