"""Reachable sets of the vehicles of a batch over the horizon, cut by their scenarios: the sets behind a tube.

They are computed in two ways. A vehicle whose scenarios ask, at every step, for one set of constant half-spaces and
strips is *unbranched*: all of its steps are computed in one compiled loop. Every other vehicle may have branches, and
predicates that depend on the set; its steps are computed one after the other, with all such vehicles of the batch
together. Which way a vehicle goes depends on itself alone.
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from reach_server.numeric.slot_table import take_rows
from reach_server.numeric.types import FloatArray
from reach_server.sets.raw import RawSets, join_sets
from reach_server.tube.cut_schedule import CutSchedule
from reach_server.tube.unbranched import UnbranchedTubes

#: Sets with a number beyond this are not published: figures around them would not fit into floats of 32 bits.
LARGEST = 1e37


@dataclass(frozen=True, slots=True, eq=False)
class ReachSets:
    """Sets of B vehicles at steps 1 to N, and those without side information, ``free``.

    ``area`` and ``area_free`` (B, N), ``heights`` (B, N, K) over the directions of an outline and ``hull`` (B, N, 2, n)
    as in ``SetSummary``. ``active`` (B, N, L): the literals that cut the sets of a step. ``bounded`` (B,): all sets are
    finite. ``emptied`` (B,): cuts left nothing, so that the sets are the free ones. ``excluded`` (B,): the data
    excludes the stated bounds. ``responsible``: by row of a vehicle whose cuts left nothing, the step at which, and the
    literals that took part.
    """

    steps: tuple[RawSets, ...]
    free: tuple[RawSets, ...]
    area: FloatArray
    area_free: FloatArray
    heights: FloatArray
    hull: FloatArray
    active: NDArray[np.bool_]
    bounded: NDArray[np.bool_]
    emptied: NDArray[np.bool_]
    excluded: NDArray[np.bool_]
    responsible: dict[int, tuple[int, list[int]]]

    @staticmethod
    def of(tubes: UnbranchedTubes, schedule: CutSchedule, literals: int) -> "ReachSets":
        """The sets of unbranched vehicles."""
        return ReachSets(
            _zonotopes(tubes.center, tubes.generators), _zonotopes(tubes.free_center, tubes.free_generators),
            tubes.area, tubes.area_free, tubes.heights, tubes.hull,
            tubes.active_literals(schedule, literals)[:, 1:], tubes.bounded, tubes.ended >= 0, tubes.contradicted, {},
        )  # fmt: skip

    def publishable(self) -> NDArray[np.bool_]:
        """Of which vehicles (B,) every set is finite, and small enough for a message."""
        # A constrained set may be small where the zonotope that is published around it is not.
        sizes = [np.abs(s.generators).sum(axis=2).max(axis=1, initial=0.0) for s in self.steps if s.matrix.shape[1]]
        sizes += [np.abs(s.center).max(axis=1) for s in self.steps]
        sizes += [np.abs(a).reshape(len(a), -1).max(axis=1, initial=0.0) for a in (self.hull, self.heights)]
        areas = np.maximum(self.area, self.area_free).max(axis=1, initial=0.0)
        # What is no number is not small.
        fits = np.all([size <= LARGEST for size in sizes], axis=0) & (areas <= LARGEST**2)
        return np.asarray(self.bounded & fits)

    def rows(self, rows: NDArray[np.intp]) -> "ReachSets":
        """The sets of some vehicles (K,), in that order."""
        arrays: list[Any] = []
        for f in fields(self)[:-1]:
            value = getattr(self, f.name)
            arrays.append(tuple(take_rows(s, rows) for s in value) if isinstance(value, tuple) else value[rows])
        index = {row: number for number, row in enumerate(rows.tolist())}
        arrays.append({index[row]: what for row, what in self.responsible.items() if row in index})
        return ReachSets(*arrays)

    @staticmethod
    def together(parts: Sequence["ReachSets"], order: NDArray[np.intp]) -> "ReachSets":
        """The sets of several batches, concatenated and then put into the ``order`` of rows given."""
        if len(parts) == 1:
            # One batch is in order.
            return parts[0]
        arrays: list[Any] = []
        for f in fields(ReachSets)[:-1]:
            values = [getattr(part, f.name) for part in parts]
            if isinstance(values[0], tuple):
                arrays.append(tuple(join_sets(list(sets)) for sets in zip(*values, strict=True)))
            else:
                arrays.append(np.concatenate(values))
        responsible: dict[int, tuple[int, list[int]]] = {}
        before = 0
        for part in parts:
            responsible |= {before + row: what for row, what in part.responsible.items()}
            before += len(part.area)
        arrays.append(responsible)
        return ReachSets(*arrays).rows(order)


def _zonotopes(center: FloatArray, generators: FloatArray) -> tuple[RawSets, ...]:
    """Sets by step, from center (B, N, n) and generators (B, N, n, g)."""
    count, steps, _, g = generators.shape
    matrix, offset = np.zeros((count, 0, g)), np.zeros((count, 0))
    return tuple(RawSets(center[:, k], generators[:, k], matrix, offset) for k in range(steps))
