"""The same questions put to other libraries: HiGHS (by SciPy and by its own interface) and ZonoOpt."""

from typing import Any

import highspy
import numpy as np
import zonoopt
from scipy.optimize import linprog
from scipy.sparse import csc_matrix

from benchmarks.families import Sets
from reach_server.numeric.types import FloatArray

#: Tolerance of the reference values.
REFERENCE = 1e-10


def zonoopt_set(sets: Sets, i: int) -> Any:
    """Set i as a ``zonoopt.ConZono``."""
    return zonoopt.ConZono(csc_matrix(sets.generators[i]), np.zeros(2), csc_matrix(sets.matrix[i]), sets.offset[i])


def zonoopt_settings(tolerance: float) -> Any:
    """Settings that stop at this primal and dual residual."""
    settings = zonoopt.OptSettings()
    settings.eps_prim = settings.eps_dual = tolerance
    settings.k_max_admm = 100_000
    return settings


def linprog_support(sets: Sets, i: int, direction: FloatArray) -> float:
    """Support of set i by ``scipy.optimize.linprog``."""
    cost = -(direction @ sets.generators[i])
    result = linprog(cost, A_eq=sets.matrix[i], b_eq=sets.offset[i], bounds=(-1, 1), method="highs")
    return -float(np.nan if result.fun is None else result.fun)


class Program:
    """The linear program of set i in HiGHS' own interface; keeps its basis from one direction to the next."""

    def __init__(self, sets: Sets, i: int, tolerance: float | None = None) -> None:
        self._generators = sets.generators[i]
        rows, g = sets.matrix[i].shape
        self._highs: Any = highspy.Highs()  # type: ignore[no-untyped-call]
        self._highs.setOptionValue("output_flag", False)
        self._highs.setOptionValue("threads", 1)
        if tolerance is not None:
            self._highs.setOptionValue("primal_feasibility_tolerance", tolerance)
            self._highs.setOptionValue("dual_feasibility_tolerance", tolerance)
        lp = highspy.HighsLp()
        lp.num_col_, lp.num_row_ = g, rows
        lp.col_cost_ = np.zeros(g)
        lp.col_lower_, lp.col_upper_ = -np.ones(g), np.ones(g)
        lp.row_lower_ = lp.row_upper_ = sets.offset[i]
        lp.a_matrix_.format_ = highspy.MatrixFormat.kRowwise
        lp.a_matrix_.start_ = np.arange(0, rows * g + 1, g)
        lp.a_matrix_.index_ = np.tile(np.arange(g), rows)
        lp.a_matrix_.value_ = sets.matrix[i].ravel()
        self._highs.passModel(lp)
        self._columns = np.arange(g, dtype=np.int32)

    def support(self, direction: FloatArray) -> float:
        """Support of the set in ``direction`` (2,)."""
        self._highs.changeColsCost(len(self._columns), self._columns, -(direction @ self._generators))
        self._highs.run()
        return -float(self._highs.getInfo().objective_function_value)
