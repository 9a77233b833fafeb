"""Ring buffers of samples, compiled: which samples are stored, at which index, and which of them follow each other."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fleet_bus.messages import StateFlag
from reach_server.data import pose_jumps
from reach_server.data.pose_jumps import FOLLOWS, ContinuityRules, broken_by
from reach_server.data.stream_order import LATEST, Rivals, lost_at_most, note, paused_at_most
from reach_server.numeric.jit import YES, kernel
from reach_server.numeric.types import BoolArray, FloatArray, IntArray

#: Numbers of a magnitude above this are no measurements; their squares would overflow.
GREATEST = 1e30

#: Status of a sample: one of these values, and for a stored one any of the bits below and of ``pose_jumps``.
STORED, REPEATED, BACKWARDS, STOPPED, NOT_FINITE, TOO_OLD, LEAP = 0, 1, 2, 3, 4, 5, 6
REFUSED = 7
NO_INPUT, FROZEN, JUMPED, RESYNCED, AFTER_FROZEN = (
    8, pose_jumps.FROZEN, pose_jumps.JUMPED, 64, pose_jumps.AFTER_FROZEN,
)  # fmt: skip

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
    ``SampleArrays``."""

    epoch: NDArray[np.uint64]
    seq: NDArray[np.uint64]
    t: IntArray
    flags: NDArray[np.uint32]
    x: FloatArray
    u: FloatArray
    run: NDArray[np.int32]
    input_known: BoolArray
    gated: BoolArray


@kernel
def scan(batch: Samples, ring: Ring, count: IntArray, late: BoolArray) -> tuple[bool, bool]:
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
    status: NDArray[np.uint8],
) -> None:
    """Append samples sorted by (vehicle, epoch, seq), newer than what is stored, and set the ``status`` (B,) of
    each; ``number`` is that of the batch."""
    size = ring.t.shape[1]
    for k in range(len(batch.vehicle)):
        slot = batch.vehicle[k]
        status[k] = _admit(batch, k, number, ring, count[slot], rivals, rules.interval)
        if status[k] & REFUSED:
            continue
        rivals.live[slot] = rivals.won[slot] = False
        index = count[slot] % size
        status[k] |= _write(batch, k, ring, index, rules, min(count[slot], size - 1))
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
    if follows != STORED and note(rivals, slot, epoch, seq, t, number, interval, YES):
        return RESYNCED
    return follows


@kernel
def contest(batch: Samples, number: int, status: NDArray[np.uint8], rivals: Rivals, interval: int) -> int:
    """The first of the late samples of one vehicle, sorted, that is believed to be newer than what is stored, or -1.

    ``status`` (B,) of the samples; those recorded before the start of the vehicle are expected to be late."""
    for k in range(len(batch.vehicle)):
        faulty = status[k] == NOT_FINITE or batch.t[k] > LATEST
        if not faulty and batch.flags[k] & _HISTORY == 0:
            against = status[k] == BACKWARDS or status[k] == STOPPED or status[k] == LEAP
            if note(rivals, batch.vehicle[k], batch.epoch[k], batch.seq[k], batch.t[k], number, interval, against):
                return k
    return -1


@kernel
def fit_in(batch: Samples, held: BoolArray, status: NDArray[np.uint8]) -> None:
    """Set the ``status`` of samples of one vehicle, sorted by (epoch, seq). Stored are all ``held`` ones, and of the
    others those whose key is new and whose stamps lie between those of their neighbours."""
    last = -1
    for k in range(len(batch.vehicle)):
        status[k] = STORED if held[k] else _fits(batch, k, last)
        if status[k] == STORED:
            last = k
    following = -1
    for k in range(len(batch.vehicle) - 1, -1, -1):
        if status[k] == STORED:
            if not held[k] and following >= 0 and batch.t[k] >= batch.t[following]:
                if batch.epoch[k] != batch.epoch[following]:
                    # An older epoch has ended before a newer one begins.
                    status[k] = LEAP
                else:
                    status[k] = STOPPED if batch.t[k] == batch.t[following] else BACKWARDS
            if status[k] == STORED:
                following = k


@kernel
def _fits(batch: Samples, k: int, last: int) -> int:
    """Status of sample k after the one stored before it, ``last`` (-1 for none)."""
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
    """NOT_FINITE or LEAP where sample k is invalid by itself, else STORED."""
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
    batch: Samples, gated: BoolArray, start: int, ring: Ring, rules: ContinuityRules, status: NDArray[np.uint8]
) -> None:
    """Write the sorted samples of one vehicle, no more than the ring holds, from index ``start`` on."""
    size = ring.t.shape[1]
    for k in range(len(batch.vehicle)):
        index = (start + k) % size
        status[k] = _write(batch, k, ring, index, rules, k)
        ring.gated[batch.vehicle[k], index] = gated[k]


@kernel
def _write(batch: Samples, k: int, ring: Ring, index: int, rules: ContinuityRules, held: int) -> int:
    """Store sample k at ``index``, with ``held`` samples before it; the bits of its status."""
    slot = batch.vehicle[k]
    ring.epoch[slot, index] = batch.epoch[k]
    ring.seq[slot, index] = batch.seq[k]
    ring.t[slot, index] = batch.t[k]
    for i in range(batch.x.shape[1]):
        ring.x[slot, index, i] = batch.x[k, i]
    finite = True
    for i in range(batch.u.shape[1]):
        finite = finite and abs(batch.u[k, i]) <= GREATEST
    for i in range(batch.u.shape[1]):
        ring.u[slot, index, i] = batch.u[k, i] if finite else 0.0
    known = batch.flags[k] & _MISSING == 0
    ring.flags[slot, index] = batch.flags[k] if finite else batch.flags[k] | np.uint32(_MISSING)
    ring.input_known[slot, index] = known and finite
    ring.gated[slot, index] = False
    ring.run[slot, index] = 0
    found = NO_INPUT if known and not finite else STORED
    if held == 0:
        return found
    size = ring.t.shape[1]
    before = (index - 1) % size
    elapsed = ring.t[slot, index] - ring.t[slot, before]
    if (
        ring.epoch[slot, index] != ring.epoch[slot, before]
        or ring.seq[slot, index] != ring.seq[slot, before] + np.uint64(1)
        or ring.flags[slot, index] & _NEW != 0
        or abs(elapsed - rules.interval) > rules.slack
    ):
        return found
    broken = broken_by(ring.x, ring.run, slot, before, held, elapsed * 1e-9, rules)
    if broken == FOLLOWS:
        ring.run[slot, index] = min(ring.run[slot, before], 2**30) + 1
    return found | broken
