"""Counts of values by size, in whole arrays at a time: what a Prometheus histogram is made of."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike


class Histogram:
    """How many values were at most as great as each of some ``bounds``, ascending, and their sum.

    One thread adds, any thread reads: what is read belongs together.
    """

    def __init__(self, bounds: Sequence[float]) -> None:
        self.bounds = tuple(bounds)
        self._bounds = np.array(bounds, dtype=np.float64)
        #: Replaced as one, never changed.
        self._state = np.zeros(len(self.bounds) + 1, dtype=np.int64), 0.0

    def add(self, values: ArrayLike) -> None:
        """Count finite values, one or many."""
        array = np.atleast_1d(np.asarray(values, dtype=np.float64))
        counts, total = self._state
        index = np.searchsorted(self._bounds, array, side="left")
        self._state = counts + np.bincount(index, minlength=len(counts)), total + float(array.sum())

    def read(self) -> tuple[list[int], float]:
        """How many values were at most each bound, then how many there were; and their sum."""
        counts, total = self._state
        return np.cumsum(counts).tolist(), total
