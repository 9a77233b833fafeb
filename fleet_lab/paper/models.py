"""The sets of the next position before any cut: Algorithm 1 in the ways it can be read."""

from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.spatial.distance import pdist, squareform

from fleet_lab.paper.algorithm_1 import Printed
from fleet_lab.paper.drives import Data
from reach_server.numeric.checks import stack_columns
from reach_server.numeric.types import FloatArray
from reach_server.sets import Zonotope

#: The paper's noise: Z_w = <0, [0.9 0.9]ᵀ> and Z_v = <0, [0.01 0.01]ᵀ>, m.
PROCESS_NOISE: Final = np.array([[0.9], [0.9]])
MEASUREMENT_NOISE: Final = np.array([[0.01], [0.01]])


@dataclass(frozen=True, slots=True, eq=False)
class Model:
    """``after = matrix [1; x; u] + residual`` by least squares, matrix (2, 5), residuals from ``low`` to ``high`` (2,).

    With data of full rank it is the same for every linearisation point, so one fit serves all steps.
    """

    matrix: FloatArray
    low: FloatArray
    high: FloatArray

    @staticmethod
    def of(data: Data) -> "Model":
        """Fit to some data."""
        design = np.column_stack([np.ones(len(data.x)), data.x, data.u])
        solution = np.linalg.lstsq(design, data.after, rcond=None)[0].astype(np.float64)
        residual = data.after - design @ solution
        return Model(solution.T, residual.min(axis=0), residual.max(axis=0))

    def centers(self, x: FloatArray, u: FloatArray) -> FloatArray:
        """Where points (S, 2) under inputs (S, 2) go, in the middle of the residuals (S, 2)."""
        design = np.column_stack([np.ones(len(x)), x, u])
        found: FloatArray = design @ self.matrix.T + (self.low + self.high) / 2
        return found


def as_published_code(data: Data, x: FloatArray, u: FloatArray) -> Zonotope:
    """The sets (S,) from positions (S, 2) under inputs (S, 2) that the authors' code computes: line 4 of Algorithm 1
    with an interval hull of ``box(residuals) - Z_w``, neither Z_ε nor measurement noise.

    With this Z_w it is a box of 0.9 m and the segment: 12 · 0.81 m² = 9.72 m² and what the residuals add.
    """
    model = Model.of(data)
    half = (model.high - model.low) / 2 + np.abs(PROCESS_NOISE).sum(axis=1)
    return _sets(model.centers(x, u), stack_columns(np.diag(half), PROCESS_NOISE))


def as_printed(data: Data, x: FloatArray, u: FloatArray) -> Zonotope:
    """The sets that the text of Algorithm 1 gives: both Z_w stay a segment, Z_ε is L* δ as estimated from the data,
    measurement noise is no part of it."""
    algorithm = printed(data)
    nothing = np.zeros((2, 0))
    _, generators = algorithm.step((x[0], nothing), (u[0], nothing))
    return _sets(Model.of(data).centers(x, u), generators)


def printed(data: Data) -> Printed:
    """Algorithm 1 with L* and δ from the data: the steepest slope between two of its transitions, and the greatest
    distance of one to its nearest neighbour. Both are estimates from below, as the paper's are."""
    distance = squareform(pdist(np.column_stack([data.x, data.u])))
    np.fill_diagonal(distance, np.inf)
    slope = float((squareform(pdist(data.after)) / distance).max())
    return Printed(data.x, data.u, data.after, np.zeros(2), PROCESS_NOISE, slope, float(distance.min(axis=1).max()))


def with_noise(data: Data, x: FloatArray, u: FloatArray) -> Zonotope:
    """As the published code, with the measurement noise where it belongs: positions (S, 2) and data are measured, so
    ``R_0 = x - Z_v`` goes through the model, and a residual tells of f up to ``N = -Z_w - Z_v + A Z_v``: three times
    Z_v in all, up to A. An outer bound of that sum; its parallel segments are one."""
    model = Model.of(data)
    # Generators that are nearly parallel help nobody: A Z_v lies in Z_v and a box around the difference.
    beside = np.abs((model.matrix[:, 1:3] - np.eye(2)) @ MEASUREMENT_NOISE).sum(axis=1)
    half = (model.high - model.low) / 2 + np.abs(PROCESS_NOISE).sum(axis=1) + 2 * beside
    return _sets(model.centers(x, u), stack_columns(np.diag(half), PROCESS_NOISE + 3 * MEASUREMENT_NOISE))


def _sets(center: FloatArray, generators: FloatArray) -> Zonotope:
    return Zonotope(center, np.broadcast_to(generators, (len(center), *generators.shape)))
