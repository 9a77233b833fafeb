"""Which numbers and stamps may follow each other, and when a stream that was refused is believed after all.

There is no clock in here: samples are held against each other. One sample may be wrong in any of its numbers, several
that agree with each other are a stream.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from reach_server.numeric.jit import kernel

#: A number may leap by this many samples, and by ``PACE`` times as many as the stamps say; a stamp by this many sample
#: times, and by ``PACE`` times what the numbers say. Wide enough for losses, and for a source of another rate.
SPARE, PACE = 10.0, 10.0
#: Stamps above this, in the year 2116, are no times: what is computed from them would overflow.
LATEST = 2**62
#: Samples in a row that contradict what is stored and agree with each other, after which the next one is believed.
RESYNC = 3
#: Batches in a row that agree with each other, and with nothing newer than what is stored, after which the next one is
#: believed. More than ``RESYNC``, for late samples do not contradict: a cache repeats its samples in a few batches.
LATE_BATCHES = 20


class Rivals(NamedTuple):
    """By slot (V,) the stream that is not the one stored: its newest sample (``epoch``, ``seq``, ``t``) where it is
    ``live``, how many of its samples in a row contradicted what is stored (``run``), in how many batches it came
    (``batches``), the last of them ``last``; and whether it has ``won``: its next sample is stored whatever it says."""

    live: NDArray[np.bool_]
    won: NDArray[np.bool_]
    epoch: NDArray[np.uint64]
    seq: NDArray[np.uint64]
    t: NDArray[np.int64]
    run: NDArray[np.int64]
    batches: NDArray[np.int64]
    last: NDArray[np.int64]

    @classmethod
    def none(cls) -> "Rivals":
        """Of no vehicles."""
        no, none, never = np.zeros(0, dtype=bool), np.zeros(0, dtype=np.uint64), np.zeros(0, dtype=np.int64)
        return cls(no, no, none, none, never, never, never, never)

    def forget(self, slot: int) -> None:
        """No stream but the one stored."""
        self.live[slot] = self.won[slot] = False


@kernel
def lost_at_most(seq_before: np.uint64, t_before: int, seq: np.uint64, t: int, interval: int) -> bool:
    """Whether a number, above the one before and with a stamp above its, leaps no further than losses explain."""
    return bool(np.float64(seq - seq_before) <= SPARE + PACE * ((t - t_before) / interval))


@kernel
def paused_at_most(seq_before: np.uint64, t_before: int, seq: np.uint64, t: int, interval: int) -> bool:
    """Whether a stamp leaps no further than the numbers explain; arguments as in ``lost_at_most``."""
    return bool((t - t_before) / interval <= SPARE + PACE * np.float64(seq - seq_before))


@kernel
def note(
    rivals: Rivals, slot: int, epoch: np.uint64, seq: np.uint64, t: int, batch: int, interval: int, against: bool
) -> bool:
    """Record a sample that does not continue what is stored, in the batch of that number; whether it is now believed.

    ``against``: it contradicts what is stored, is not merely late. The same sample again says nothing.
    """
    if rivals.live[slot] and rivals.epoch[slot] == epoch:
        before, stamp = rivals.seq[slot], rivals.t[slot]
        if seq == before and t == stamp:
            return False
        goes_on = bool(
            seq > before
            and t > stamp
            and lost_at_most(before, stamp, seq, t, interval)
            and paused_at_most(before, stamp, seq, t, interval)
        )
    else:
        goes_on = False
    if not goes_on:
        rivals.run[slot] = rivals.batches[slot] = 0
    if not goes_on or rivals.last[slot] != batch:
        rivals.batches[slot] += 1
    if (against and rivals.run[slot] >= RESYNC) or rivals.batches[slot] > LATE_BATCHES:
        return True
    rivals.run[slot] += 1 if against else 0
    rivals.live[slot] = True
    rivals.epoch[slot], rivals.seq[slot], rivals.t[slot], rivals.last[slot] = epoch, seq, t, batch
    return False
