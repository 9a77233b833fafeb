"""Requests: the vehicles of a round that get a tube, and what is known of their later inputs."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from reach_server.data.window import Block
from reach_server.numeric.slot_table import take_rows
from reach_server.numeric.types import FloatArray
from reach_server.sets.raw import RawSets


@dataclass(frozen=True, slots=True, eq=False)
class PlannedInputs:
    """Later inputs of a batch that are known, in the units of the profile: those of steps 1 to N - 1, ``plan``
    (B, N - 1, m), each within ``tolerance`` (B, m) of it."""

    plan: FloatArray
    tolerance: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class TubeRequest:
    """Vehicles (B,): their slots, their newest samples as identified and stamped, the newest part of their windows, and
    the inputs to come."""

    slots: NDArray[np.intp]
    epoch: NDArray[np.uint64]
    seq: NDArray[np.uint64]
    t: NDArray[np.int64]
    block: Block
    known: PlannedInputs | None
    prior: "Prior | None" = None

    def rows(self, rows: NDArray[np.intp]) -> "TubeRequest":
        """The request of some rows, ascending."""
        if len(rows) == len(self.slots):
            return self
        known = None if self.known is None else take_rows(self.known, rows)
        prior = None
        if self.prior is not None:
            retained = np.flatnonzero(np.isin(self.prior.rows, rows))
            prior = Prior(np.searchsorted(rows, self.prior.rows[retained]), take_rows(self.prior.sets, retained))
        return TubeRequest(
            self.slots[rows], self.epoch[rows], self.seq[rows], self.t[rows], take_rows(self.block, rows), known, prior
        )


@dataclass(frozen=True, slots=True, eq=False)
class Prior:
    """What was predicted for the newest samples of some of the vehicles, ``rows`` (K,): ``sets`` (K) of true states."""

    rows: NDArray[np.intp]
    sets: RawSets
