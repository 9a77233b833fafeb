"""Compiled loops over the samples of ring buffers: what is stored, what follows what, and what is no honest pose."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fleet_bus.messages import StateFlag
from reach_server.data.leaps import LATEST, Rivals, lost_at_most, note, paused_at_most
from reach_server.numeric.jit import kernel
from reach_server.numeric.types import BoolArray, FloatArray, IntArray

#: A pose jumps where it changes by more than this times what rates and speed limits allow,
ALLOWED_CHANGE = 2.0
#: or, without those, by more than this times every change between linked samples in the window,
SEEN_CHANGE = 10.0
#: and by more than this times what its own speed says.
OWN_SPEED = 3.0
#: A vehicle moves where its speed says more than this share of the greatest change of position in the window.
MOVING = 0.05
#: Links in the window below which nothing is said about the changes of a vehicle.
LEAST_LINKS = 50
#: Numbers of a magnitude above this are no measurements; their squares would overflow.
GREATEST = 1e30

#: What becomes of a sample: one of the first, or stored with any of the rest.
STORED, REPEATED, BACKWARDS, STOPPED, NOT_FINITE, TOO_OLD, LEAP = 0, 1, 2, 3, 4, 5, 6
REFUSED = 7
NO_INPUT, STALE, JUMPED, RESYNCED, AFTER_STALE = 8, 16, 32, 64, 128

_MISSING = int(StateFlag.INPUT_MISSING)
_NEW = int(StateFlag.NEW_TRAJECTORY)
_HISTORY = int(StateFlag.HISTORY)


class Samples(NamedTuple):
    """Samples (B, ·) as in ``SampleBatch``, contiguous."""

    vehicle: IntArray
    epoch: NDArray[np.uint64]
    seq: NDArray[np.uint64]
    t: IntArray
    flags: NDArray[np.uint32]
    x: FloatArray
    u: FloatArray


class Ring(NamedTuple):
    """Ring buffers (V, S, ·) of samples, and what follows from them; ``run``, ``input_known`` and ``gated`` as in
    ``Columns``."""

    epoch: NDArray[np.uint64]
    seq: NDArray[np.uint64]
    t: IntArray
    flags: NDArray[np.uint32]
    x: FloatArray
    u: FloatArray
    run: NDArray[np.int32]
    input_known: BoolArray
    gated: BoolArray


class ContinuityRules(NamedTuple):
    """When samples follow each other: sample ``interval`` within ``slack`` (ns), and what counts as a jump.

    ``angle`` (n,); ``pose`` (n,) are the states that may jump, ``top`` (n,) how much they may change per second (inf
    where nothing is stated), ``margin`` (n,) what two measurement errors explain. ``first`` and ``second`` are the
    positions, whose change is their distance, and ``speed`` the state that says how fast it grows; -1 where no role
    names them.
    """

    interval: int
    slack: float
    angle: BoolArray
    pose: BoolArray
    top: FloatArray
    margin: FloatArray
    first: int
    second: int
    speed: int


@kernel
def survey(batch: Samples, ring: Ring, count: IntArray, late: BoolArray) -> tuple[bool, bool]:
    """Mark samples that are not newer, by (epoch, seq), than the newest one stored of their vehicle; whether the batch
    is sorted by (vehicle, epoch, seq), and whether anything is marked."""
    size = ring.t.shape[1]
    in_order, any_late = True, False
    for k in range(len(batch.vehicle)):
        slot, epoch, seq = batch.vehicle[k], batch.epoch[k], batch.seq[k]
        if k > 0:
            before = batch.vehicle[k - 1]
            if slot < before or (
                slot == before
                and (epoch < batch.epoch[k - 1] or (epoch == batch.epoch[k - 1] and seq < batch.seq[k - 1]))
            ):
                in_order = False
        late[k] = False
        if count[slot] > 0:
            newest = (count[slot] - 1) % size
            known = ring.epoch[slot, newest]
            late[k] = epoch < known or (epoch == known and seq <= ring.seq[slot, newest])
            any_late = any_late or late[k]
    return in_order, any_late


@kernel
def append(
    batch: Samples,
    number: int,
    ring: Ring,
    count: IntArray,
    rivals: Rivals,
    rules: ContinuityRules,
    fate: NDArray[np.uint8],
) -> None:
    """Append samples sorted by (vehicle, epoch, seq), newer than what is stored, each with its fate; ``number`` is that
    of the batch."""
    size = ring.t.shape[1]
    for k in range(len(batch.vehicle)):
        slot = batch.vehicle[k]
        fate[k] = _admit(batch, k, number, ring, count[slot], rivals, rules.interval)
        if fate[k] & REFUSED:
            continue
        rivals.live[slot] = rivals.won[slot] = False
        place = count[slot] % size
        fate[k] |= _write(batch, k, ring, place, rules, min(count[slot], size - 1))
        count[slot] += 1


@kernel
def _admit(batch: Samples, k: int, number: int, ring: Ring, count: int, rivals: Rivals, interval: int) -> int:
    """Whether sample k of a sorted batch is stored after the newest one: STORED, RESYNCED, or why not."""
    slot, epoch, seq, t = batch.vehicle[k], batch.epoch[k], batch.seq[k], batch.t[k]
    newest = (count - 1) % ring.t.shape[1]
    if count > 0 and ring.epoch[slot, newest] == epoch and ring.seq[slot, newest] == seq:
        return REPEATED
    fault = _fault(batch, k)
    if fault != STORED:
        return fault
    if rivals.won[slot]:
        return RESYNCED
    if count == 0:
        return STORED
    stamp, before = ring.t[slot, newest], ring.seq[slot, newest]
    if ring.epoch[slot, newest] != epoch:
        # An epoch is the time of a start, or a count of starts: in either case no more than the stamp.
        follows = STORED if t > stamp and t > 0 and epoch <= np.uint64(t) else LEAP
    elif t <= stamp:
        follows = STOPPED if t == stamp else BACKWARDS
    else:
        # Where a trajectory begins, and where what was recorded ends, any time may have passed.
        begins = batch.flags[k] & _NEW != 0 or (
            batch.flags[k] & _HISTORY == 0 and ring.flags[slot, newest] & _HISTORY != 0
        )
        follows = LEAP
        if lost_at_most(before, stamp, seq, t, interval) and (
            begins or paused_at_most(before, stamp, seq, t, interval)
        ):
            follows = STORED
    if follows != STORED and note(rivals, slot, epoch, seq, t, number, interval, True):
        return RESYNCED
    return follows


@kernel
def contest(batch: Samples, number: int, fate: NDArray[np.uint8], rivals: Rivals, interval: int) -> int:
    """Take in late samples of one vehicle, sorted, and what became of them; the first row that is believed to be newer
    than what is stored, or -1. What was recorded before the start of a vehicle is late by right."""
    for k in range(len(batch.vehicle)):
        faulty = fate[k] == NOT_FINITE or batch.t[k] > LATEST
        if not faulty and batch.flags[k] & _HISTORY == 0:
            against = fate[k] == BACKWARDS or fate[k] == STOPPED or fate[k] == LEAP
            if note(rivals, batch.vehicle[k], batch.epoch[k], batch.seq[k], batch.t[k], number, interval, against):
                return k
    return -1


@kernel
def fit_in(batch: Samples, held: BoolArray, fate: NDArray[np.uint8]) -> None:
    """Which samples of one vehicle, sorted by (epoch, seq), are stored: all ``held`` ones, and of the others those that
    are not among them already and whose stamps lie between those of their neighbours."""
    last = -1
    for k in range(len(batch.vehicle)):
        fate[k] = STORED if held[k] else _fits(batch, k, last)
        if fate[k] == STORED:
            last = k
    following = -1
    for k in range(len(batch.vehicle) - 1, -1, -1):
        if fate[k] == STORED:
            if not held[k] and following >= 0 and batch.t[k] >= batch.t[following]:
                if batch.epoch[k] != batch.epoch[following]:
                    # An older epoch has ended before a newer one begins.
                    fate[k] = LEAP
                else:
                    fate[k] = STOPPED if batch.t[k] == batch.t[following] else BACKWARDS
            if fate[k] == STORED:
                following = k


@kernel
def _fits(batch: Samples, k: int, last: int) -> int:
    """Whether sample k may follow the one stored before it, ``last`` (-1 for none)."""
    if last >= 0 and batch.epoch[k] == batch.epoch[last] and batch.seq[k] == batch.seq[last]:
        return REPEATED
    fault = _fault(batch, k)
    if fault != STORED:
        return fault
    if last < 0 or batch.epoch[k] != batch.epoch[last] or batch.t[k] > batch.t[last]:
        return STORED
    return STOPPED if batch.t[k] == batch.t[last] else BACKWARDS


@kernel
def _fault(batch: Samples, k: int) -> int:
    """Why sample k is none, whatever came before; STORED where it may be one."""
    if not _is_finite(batch.x[k]):
        return NOT_FINITE
    return LEAP if batch.t[k] > LATEST else STORED


@kernel
def _is_finite(numbers: FloatArray) -> bool:
    for number in numbers:  # noqa: SIM110 - generators do not compile
        # NaN compares as false.
        if not abs(number) <= GREATEST:
            return False
    return True


@kernel
def rebuild(
    batch: Samples, gated: BoolArray, start: int, ring: Ring, rules: ContinuityRules, fate: NDArray[np.uint8]
) -> None:
    """Write the sorted samples of one vehicle, at most as many as there are places, from place ``start`` on."""
    size = ring.t.shape[1]
    for k in range(len(batch.vehicle)):
        place = (start + k) % size
        fate[k] = _write(batch, k, ring, place, rules, k)
        ring.gated[batch.vehicle[k], place] = gated[k]


@kernel
def _write(batch: Samples, k: int, ring: Ring, place: int, rules: ContinuityRules, held: int) -> int:
    """Store sample k, before which ``held`` places are filled, and what follows from it."""
    slot = batch.vehicle[k]
    ring.epoch[slot, place] = batch.epoch[k]
    ring.seq[slot, place] = batch.seq[k]
    ring.t[slot, place] = batch.t[k]
    for i in range(batch.x.shape[1]):
        ring.x[slot, place, i] = batch.x[k, i]
    finite = True
    for i in range(batch.u.shape[1]):
        finite = finite and abs(batch.u[k, i]) <= GREATEST
    for i in range(batch.u.shape[1]):
        ring.u[slot, place, i] = batch.u[k, i] if finite else 0.0
    known = batch.flags[k] & _MISSING == 0
    ring.flags[slot, place] = batch.flags[k] if finite else batch.flags[k] | np.uint32(_MISSING)
    ring.input_known[slot, place] = known and finite
    ring.gated[slot, place] = False
    ring.run[slot, place] = 0
    found = NO_INPUT if known and not finite else STORED
    if held == 0:
        return found
    size = ring.t.shape[1]
    before = (place - 1) % size
    elapsed = ring.t[slot, place] - ring.t[slot, before]
    if (
        ring.epoch[slot, place] != ring.epoch[slot, before]
        or ring.seq[slot, place] != ring.seq[slot, before] + np.uint64(1)
        or ring.flags[slot, place] & _NEW != 0
        or abs(elapsed - rules.interval) > rules.slack
    ):
        return found
    broken = _breaks(ring.x, ring.run, slot, before, held, elapsed * 1e-9, rules)
    if broken == STORED:
        ring.run[slot, place] = min(ring.run[slot, before], 2**30) + 1
    return found | broken


@kernel
def _breaks(
    x: FloatArray, run: NDArray[np.int32], slot: int, before: int, held: int, elapsed: float, rules: ContinuityRules
) -> int:
    """JUMPED, STALE or AFTER_STALE where the pose after place ``before`` does not follow from the one there."""
    size = x.shape[1]
    place = (before + 1) % size
    said = 0.0
    if rules.speed >= 0:
        said = max(abs(x[slot, before, rules.speed]), abs(x[slot, place, rules.speed])) * elapsed
    for i in range(len(rules.pose)):
        change = _change(x, slot, before, place, i, rules)
        if change <= rules.margin[i]:
            continue
        if rules.top[i] < np.inf:
            if change > ALLOWED_CHANGE * rules.top[i] * elapsed + rules.margin[i]:
                return JUMPED
        elif rules.pose[i]:
            own = said if i in (rules.first, rules.second) else 0.0
            if change > OWN_SPEED * own and _exceeds(x, run, slot, before, held, i, change, SEEN_CHANGE, rules):
                return JUMPED
    if rules.speed < 0 or rules.first < 0 or said <= rules.margin[rules.first]:
        return STORED
    repeats = _is_still(x, slot, before, place, rules)
    # What follows a repeated pose makes up for it: an increment of two intervals.
    after = held > 1 and run[slot, before] == 0 and _is_still(x, slot, (before - 1) % size, before, rules)
    if (repeats or after) and _exceeds(x, run, slot, before, held, rules.first, said, MOVING, rules):
        return STALE if repeats else AFTER_STALE
    return STORED


@kernel
def _is_still(x: FloatArray, slot: int, before: int, place: int, rules: ContinuityRules) -> bool:
    first, second = rules.first, rules.second
    return bool(x[slot, place, first] == x[slot, before, first] and x[slot, place, second] == x[slot, before, second])


@kernel
def _change(x: FloatArray, slot: int, before: int, place: int, i: int, rules: ContinuityRules) -> float:
    """How much a state changes: the distance for positions, the lesser turn for angles."""
    if i in (rules.first, rules.second):
        return math.hypot(
            x[slot, place, rules.first] - x[slot, before, rules.first],
            x[slot, place, rules.second] - x[slot, before, rules.second],
        )
    change = abs(x[slot, place, i] - x[slot, before, i])
    if rules.angle[i] and change > math.pi:
        change %= 2 * math.pi
        change = min(change, 2 * math.pi - change)
    return float(change)


@kernel
def _exceeds(
    x: FloatArray, run: NDArray[np.int32], slot: int, newest: int, held: int, i: int, change: float, share: float,
    rules: ContinuityRules,
) -> bool:  # fmt: skip
    """Whether ``change`` exceeds ``share`` times every change of state i between linked ones of the ``held`` samples up
    to ``newest``, some change among enough links presupposed."""
    size = x.shape[1]
    links, moved = 0, False
    for back in range(held - 1):
        place = (newest - back) % size
        if run[slot, place] > 0:
            seen = _change(x, slot, (place - 1) % size, place, i, rules)
            if change <= share * seen:
                return False
            links += 1
            moved = moved or seen > 0.0
    return moved and links >= LEAST_LINKS
