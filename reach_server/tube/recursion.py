"""The recursion over the horizon, from the sets of one sample to those of the next (``step_kernel`` says why it is
outer)."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from reach_server.data.input_sets import InputSets
from reach_server.data.regressors import RegressorSpec
from reach_server.models.residual_model import Model
from reach_server.models.set_membership import Fitted
from reach_server.numeric.types import FloatArray
from reach_server.sets.raw import MAX_ROWS, RawSets
from reach_server.tube.step_kernel import StepSpec, advance_many, columns_added

#: Generators per coordinate that a set keeps (its order).
ORDER = 3


def rules_of(layout: RegressorSpec, process: FloatArray, *, membership: bool, order: int) -> StepSpec:
    """The step of a class in the form that kernels take; ``process`` noise generators (n, g), sets reduced to
    ``order``."""
    # Columns along an axis only add to a box.
    along = np.count_nonzero(process, axis=0) <= 1
    plane = layout.plane or ((0, 1) if layout.n == 2 else (-1, -1))
    return StepSpec(
        np.array(layout.free, dtype=np.int64), layout.pose or (-1, -1, -1), plane, layout.m, layout.lags,
        np.abs(process[:, along]).sum(axis=1), np.ascontiguousarray(process[:, ~along]), membership, order,
    )  # fmt: skip


@dataclass(slots=True, eq=False)
class Recursion:
    """Motion of the sets of V vehicles by their models, under ``inputs``, with ``process`` noise generators (n, g).

    ``membership`` takes set membership where it is smaller; sets are reduced to ``order`` generators per coordinate,
    those of lagged inputs counted where they are not points.
    """

    inputs: InputSets
    model: Model
    process: FloatArray
    layout: RegressorSpec
    membership: bool = True
    order: int = ORDER
    rules: StepSpec = field(init=False)
    fitted: Fitted = field(init=False)

    def __post_init__(self) -> None:
        self.rules = rules_of(self.layout, self.process, membership=self.membership, order=self.order)
        self.fitted = self.model.arrays()

    @property
    def horizon(self) -> int:
        """Steps N."""
        steps: int = self.inputs.center.shape[1]
        return steps

    def begin(self, start: RawSets, vehicle: NDArray[np.intp]) -> RawSets:
        """Sets (R, n) of states now, joined by the past inputs of the vehicles ``vehicle`` (R,) they are of: exact."""
        rows, g = len(vehicle), start.generators.shape[-1]
        past = self.inputs.past[vehicle].reshape(rows, -1)
        return RawSets(
            np.concatenate([start.center, past], axis=1),
            np.concatenate([start.generators, np.zeros((rows, past.shape[1], g))], axis=1),
            start.matrix,
            start.offset,
        )

    def advance(self, sets: RawSets, k: int, vehicle: NDArray[np.intp]) -> tuple[RawSets, NDArray[np.bool_]]:
        """Sets (R, n) after step ``k`` (from 0) of the vehicles ``vehicle`` (R,) they are of: outer; and where (R,) the
        data excludes the bounds."""
        first = max(sets.matrix.shape[1] - MAX_ROWS, 0)
        matrix, offset = sets.matrix[:, first:], sets.offset[:, first:]
        lifted = np.concatenate([sets.generators, matrix], axis=1)
        count, z = sets.center.shape
        added_columns = lifted.shape[2] + columns_added(self.fitted, self.rules)
        center, moved = np.empty((count, z)), np.empty((count, lifted.shape[1], added_columns))
        most, wrong = advance_many(
            np.ascontiguousarray(sets.center), lifted, vehicle.astype(np.int64), self.fitted,
            np.ascontiguousarray(self.inputs.center[:, k]), np.ascontiguousarray(self.inputs.half[:, k]), self.rules,
            center, moved,
        )  # fmt: skip
        moved = moved[:, :, :most]
        return RawSets(center, moved[:, :z], moved[:, z:], offset), wrong
