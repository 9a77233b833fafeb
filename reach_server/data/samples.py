"""Samples as arrays: batches received, blocks read from a window, and the report on an appended batch."""

from dataclasses import dataclass, field
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from fleet_bus.messages import StateSample
from reach_server.data import ring_buffer as ring
from reach_server.numeric.slot_table import take_rows
from reach_server.numeric.types import FloatArray, IntArray


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
    t: IntArray
    flags: NDArray[np.uint32]
    x: FloatArray
    u: FloatArray

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
        taken: Self = take_rows(self, rows)
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

    t: IntArray
    x: FloatArray
    u: FloatArray
    valid: NDArray[np.bool_]
    input_known: NDArray[np.bool_]
    linked: NDArray[np.bool_]


class SampleArrays(NamedTuple):
    """The ring buffers of a window, as compiled loops take them: the sample of a slot at index p is ``t[slot, p]``,
    ``x[slot, p]`` and so on. Without the first axis those of one vehicle.

    ``t`` (V, S) ns; ``x`` (V, S, n) as received; ``u`` (V, S, m), zero where not known; ``run`` (V, S) number of links
    that end at a sample, 0 where a trajectory begins (links to samples that have left the window count: go no further
    back than the window does); ``input_known`` (V, S); ``gated`` (V, S) set by ``Window.gate``: a glitch, to be kept
    out of models. Entries at indices that hold no sample are meaningless. Views to read from at once: growing
    replaces the arrays.
    """

    t: IntArray
    x: FloatArray
    u: FloatArray
    run: NDArray[np.int32]
    input_known: NDArray[np.bool_]
    gated: NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class AppendReport:
    """Number of samples of a batch by status.

    Each was stored, or refused: seen before (``repeated``), stamp before the newest one (``backwards``) or equal to it
    (``stopped``), a state that is no number (``not_finite``), older than all that a full window holds (``too_old``), an
    epoch, number or stamp that leaps (``leaped``). Of those stored, ``no_input`` had an input that is no number,
    ``frozen_pose`` repeated a pose while moving, and ``resynced`` were believed after others like them had been
    refused. ``status`` (B,) of each sample, as in ``ring_buffer``.
    """

    stored: int = 0
    repeated: int = 0
    backwards: int = 0
    stopped: int = 0
    not_finite: int = 0
    too_old: int = 0
    no_input: int = 0
    frozen_pose: int = 0
    resynced: int = 0
    jumped: tuple[tuple[int, int], ...] = ()
    leaped: int = 0
    status: NDArray[np.uint8] = field(default_factory=lambda: np.zeros(0, dtype=np.uint8), compare=False, repr=False)

    @property
    def refused(self) -> int:
        """Number of new samples that were refused."""
        return self.backwards + self.stopped + self.not_finite + self.leaped

    @property
    def stored_rows(self) -> NDArray[np.bool_]:
        """Which samples (B,) were stored."""
        return np.asarray(self.status & ring.REFUSED == ring.STORED)

    def rows(self, mark: int) -> list[int]:
        """Rows of the samples of one status: ``ring.JUMPED``, ``ring.LEAP``, ``ring.RESYNCED`` and so on."""
        found = self.status & ring.REFUSED == mark if mark <= ring.REFUSED else self.status & mark != 0
        rows: list[int] = np.flatnonzero(found).tolist()
        return rows
