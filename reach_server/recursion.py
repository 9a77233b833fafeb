"""The recursion over the horizon: from the sets of one sample to those of the next (``advance``: how, and why
outer)."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from reach_server.advance import Rules, advance_many, columns_added
from reach_server.factor_sets import MAX_ROWS, FactorSet
from reach_server.model import Model
from reach_server.regression import Layout
from reach_server.residuals import Fitted
from reach_server.sets.arrays import Array

#: Generators a coordinate that a set keeps (its order).
ORDER = 3


@dataclass(frozen=True, slots=True, eq=False)
class InputSets:
    """Boxes of the inputs: ``past`` (B, lags, m) known values, newest first; ``center``, ``half`` (B, N, m)."""

    past: Array
    center: Array
    half: Array


def rules_of(layout: Layout, process: Array, *, membership: bool, order: int) -> Rules:
    """What kernels need to know of a class; ``process`` noise generators (n, g), sets reduced to ``order``."""
    # Columns along an axis only add to a box.
    along = np.count_nonzero(process, axis=0) <= 1
    plane = layout.plane or ((0, 1) if layout.n == 2 else (-1, -1))
    return Rules(
        np.array(layout.free, dtype=np.int64), layout.pose or (-1, -1, -1), plane, layout.m, layout.lags,
        np.abs(process[:, along]).sum(axis=1), np.ascontiguousarray(process[:, ~along]), membership, order,
    )  # fmt: skip


@dataclass(slots=True, eq=False)
class Recursion:
    """How the sets of V vehicles move on: by their models, under ``inputs``, with ``process`` noise generators (n, g).

    ``membership`` takes set membership where it is smaller; sets are reduced to ``order``
    generators a coordinate, those of lagged inputs counted where they are no points.
    """

    inputs: InputSets
    model: Model
    process: Array
    layout: Layout
    membership: bool = True
    order: int = ORDER
    rules: Rules = field(init=False)
    fitted: Fitted = field(init=False)

    def __post_init__(self) -> None:
        self.rules = rules_of(self.layout, self.process, membership=self.membership, order=self.order)
        self.fitted = self.model.arrays()

    @property
    def horizon(self) -> int:
        """Steps N."""
        steps: int = self.inputs.center.shape[1]
        return steps

    def begin(self, start: FactorSet, vehicle: NDArray[np.intp]) -> FactorSet:
        """Sets (R, n) of states now, joined by the past inputs of the vehicles ``vehicle`` (R,) they are of: exact."""
        rows, g = len(vehicle), start.generators.shape[-1]
        past = self.inputs.past[vehicle].reshape(rows, -1)
        return FactorSet(
            np.concatenate([start.center, past], axis=1),
            np.concatenate([start.generators, np.zeros((rows, past.shape[1], g))], axis=1),
            start.matrix,
            start.offset,
        )

    def advance(self, sets: FactorSet, k: int, vehicle: NDArray[np.intp]) -> tuple[FactorSet, NDArray[np.bool_]]:
        """Sets (R, n) after step ``k`` (from 0) of the vehicles ``vehicle`` (R,) they are of: outer; and where (R,) the
        data excludes the bounds."""
        first = max(sets.matrix.shape[1] - MAX_ROWS, 0)
        matrix, offset = sets.matrix[:, first:], sets.offset[:, first:]
        lifted = np.concatenate([sets.generators, matrix], axis=1)
        count, z = sets.center.shape
        room = lifted.shape[2] + columns_added(self.fitted, self.rules)
        center, moved = np.empty((count, z)), np.empty((count, lifted.shape[1], room))
        most, wrong = advance_many(
            np.ascontiguousarray(sets.center), lifted, vehicle.astype(np.int64), self.fitted,
            np.ascontiguousarray(self.inputs.center[:, k]), np.ascontiguousarray(self.inputs.half[:, k]), self.rules,
            center, moved,
        )  # fmt: skip
        moved = moved[:, :, :most]
        return FactorSet(center, moved[:, :z], moved[:, z:], offset), wrong
