"""The sets of a batch of branches, as plain arrays: what the recursion over the horizon works on."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from reach_server.numeric.slot_table import take_rows
from reach_server.numeric.types import FloatArray
from reach_server.sets import order_reduction as reduction

#: Constraint rows kept through a propagation step; older ones are dropped, which only enlarges.
MAX_ROWS = 8


@dataclass(frozen=True, slots=True, eq=False)
class RawSets:
    """Sets (B), ``{c + Gξ : Aξ = b, |ξ| <= 1}``: center (B, z), generators (B, z, g), matrix (B, r, g),
    offset (B, r); without rows a zonotope."""

    center: FloatArray
    generators: FloatArray
    matrix: FloatArray
    offset: FloatArray

    @staticmethod
    def zonotope(center: FloatArray, generators: FloatArray) -> "RawSets":
        """A set without constraints."""
        vehicles, _, g = generators.shape
        return RawSets(center, generators, np.zeros((vehicles, 0, g)), np.zeros((vehicles, 0)))

    def reduced(self, kept: int) -> "RawSets":
        """An enclosure by ``kept`` generators and a box."""
        z, rows = self.center.shape[-1], self.matrix.shape[-2]
        first = max(rows - MAX_ROWS, 0)
        matrix, offset = self.matrix[:, first:], self.offset[:, first:]
        lifted = reduction.girard(np.concatenate([self.generators, matrix], axis=1), kept + z + rows - first)
        return RawSets(self.center, lifted[:, :z], lifted[:, z:], offset)


def join_sets(sets: list[RawSets]) -> RawSets:
    """Sets one below the other, with zero columns and rows where they differ in size."""
    n = sets[0].center.shape[1]
    g = max(s.generators.shape[2] for s in sets)
    rows = max(s.matrix.shape[1] for s in sets)

    def padded(array: FloatArray, *widths: int) -> FloatArray:
        return np.pad(array, [(0, 0), *((0, w - a) for w, a in zip(widths, array.shape[1:], strict=True))])

    return RawSets(
        np.concatenate([s.center for s in sets]),
        np.concatenate([padded(s.generators, n, g) for s in sets]),
        np.concatenate([padded(s.matrix, rows, g) for s in sets]),
        np.concatenate([padded(s.offset, rows) for s in sets]),
    )


def replace_rows(sets: RawSets, rows: NDArray[np.intp], new: RawSets) -> RawSets:
    """``sets`` with those of ``rows`` replaced, with zero columns and rows where they differ in size."""
    both = join_sets([sets, new])
    source = np.arange(len(sets.center))
    source[rows] = len(sets.center) + np.arange(len(rows))
    replaced: RawSets = take_rows(both, source)
    return replaced
