"""The sets of a batch of branches, as plain arrays: what the recursion over the horizon works on."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from reach_server.rows import take
from reach_server.sets import reduction
from reach_server.sets.arrays import Array

#: Constraint rows kept through a propagation step; older ones are dropped, which only enlarges.
MAX_ROWS = 8


@dataclass(frozen=True, slots=True, eq=False)
class FactorSet:
    """Sets (B), ``{c + Gξ : Aξ = b, |ξ| <= 1}``: center (B, z), generators (B, z, g), matrix (B, r, g),
    offset (B, r); without rows a zonotope."""

    center: Array
    generators: Array
    matrix: Array
    offset: Array

    @staticmethod
    def zonotope(center: Array, generators: Array) -> "FactorSet":
        """A set without constraints."""
        vehicles, _, g = generators.shape
        return FactorSet(center, generators, np.zeros((vehicles, 0, g)), np.zeros((vehicles, 0)))

    def reduced(self, kept: int) -> "FactorSet":
        """An enclosure by ``kept`` generators and a box."""
        z, rows = self.center.shape[-1], self.matrix.shape[-2]
        first = max(rows - MAX_ROWS, 0)
        matrix, offset = self.matrix[:, first:], self.offset[:, first:]
        lifted = reduction.girard(np.concatenate([self.generators, matrix], axis=1), kept + z + rows - first)
        return FactorSet(self.center, lifted[:, :z], lifted[:, z:], offset)


def join_sets(sets: list[FactorSet]) -> FactorSet:
    """Sets one below the other, with zero columns and rows where they differ in size."""
    n = sets[0].center.shape[1]
    g = max(s.generators.shape[2] for s in sets)
    rows = max(s.matrix.shape[1] for s in sets)

    def padded(array: Array, *widths: int) -> Array:
        return np.pad(array, [(0, 0), *((0, w - a) for w, a in zip(widths, array.shape[1:], strict=True))])

    return FactorSet(
        np.concatenate([s.center for s in sets]),
        np.concatenate([padded(s.generators, n, g) for s in sets]),
        np.concatenate([padded(s.matrix, rows, g) for s in sets]),
        np.concatenate([padded(s.offset, rows) for s in sets]),
    )


def replace_rows(sets: FactorSet, rows: NDArray[np.intp], new: FactorSet) -> FactorSet:
    """``sets`` with those of ``rows`` replaced, with zero columns and rows where they differ in size."""
    both = join_sets([sets, new])
    source = np.arange(len(sets.center))
    source[rows] = len(sets.center) + np.arange(len(rows))
    replaced: FactorSet = take(both, source)
    return replaced
