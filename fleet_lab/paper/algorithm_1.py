"""Algorithm 1 of the paper as it is printed [AJS+22], to compare with: no part of what is published.

Where it is not what `residual_hull` computes, and what that leads to:

* line 5 takes a Lipschitz constant of f and a covering radius δ; the bound speaks about f minus the model, whose
  slopes may be larger. With f(z) = z on [-2, 1] and slope -2 on [1, 2], data at -1 and 1, δ = 1, the set at 2 is
  [0, 4], but f(2) = -1;
* line 6 multiplies sets that do not count from the linearisation point by a model that does;
* measurement noise is no part of it.

Line 4 is read as a Minkowski sum with ``-Z_w``, as the code of its authors does; the difference would be smaller still.
"""

from dataclasses import dataclass

import numpy as np

from reach_server.numeric.checks import stack_columns
from reach_server.numeric.types import FloatArray
from reach_server.sets import order_reduction as reduction


@dataclass(frozen=True, slots=True, eq=False)
class Printed:
    """What Algorithm 1 takes, of one vehicle.

    Attributes:
        x, u, after: the data ``X_-`` (T, n), ``U_-`` (T, m), ``X_+`` (T, n), a row a transition.
        center, generators: the process noise Z_w, (n,) and (n, g).
        lipschitz: L*, of f.
        radius: δ, the covering radius of the data.
    """

    x: FloatArray
    u: FloatArray
    after: FloatArray
    center: FloatArray
    generators: FloatArray
    lipschitz: float
    radius: float

    def step(
        self,
        before: tuple[FloatArray, FloatArray],
        inputs: tuple[FloatArray, FloatArray],
        point: tuple[FloatArray, FloatArray] | None = None,
    ) -> tuple[FloatArray, FloatArray]:
        """The zonotope (center (n,), generators (n, g)) one step after ``before``, under ``inputs`` (center (m,),
        generators (m, g)), linearised at ``point`` (x*, u*), by default the origin: lines 1 to 6, no outer bound."""
        x, u = (np.zeros(self.x.shape[1]), np.zeros(self.u.shape[1])) if point is None else point
        design = np.column_stack([np.ones(len(self.x)), self.x - x, self.u - u])
        model = (self.after - self.center).T @ np.linalg.pinv(design).T
        residual = self.after - design @ model.T
        low, high = residual.min(axis=0), residual.max(axis=0)
        n, m = len(self.center), self.u.shape[1]
        center = model @ np.concatenate([[1.0], before[0], inputs[0]])
        generators = np.zeros((1 + n + m, before[1].shape[1] + inputs[1].shape[1]))
        generators[1 : 1 + n, : before[1].shape[1]] = before[1]
        generators[1 + n :, before[1].shape[1] :] = inputs[1]
        # Z_L with -Z_w, then Z_ε, then Z_w: the centers of the noise cancel.
        moved = stack_columns(
            model @ generators, np.diag((high - low) / 2), self.generators,
            self.lipschitz * self.radius * np.eye(n), self.generators,
        )  # fmt: skip
        return center + (low + high) / 2, moved

    def tube(
        self, start: tuple[FloatArray, FloatArray], inputs: list[tuple[FloatArray, FloatArray]], kept: int = 32
    ) -> list[tuple[FloatArray, FloatArray]]:
        """The sets of the steps that the inputs are for, each reduced to ``kept`` generators and a box: no outer bound.

        ``start`` and each of ``inputs`` are a center and generators, (n,) and (n, g), (m,) and (m, g).
        """
        found = []
        for known in inputs:
            center, generators = self.step(start, known)
            start = center, reduction.girard(generators, kept + len(center))
            found.append(start)
        return found
