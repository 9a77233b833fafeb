"""Whether points lie in planar zonotopes, against linear programs (HiGHS), on sets that such checks go wrong on."""

import numpy as np
import pytest
from scipy.optimize import linprog

from fleet_lab.paper import cuts
from reach_server.numeric.types import FloatArray
from reach_server.sets import Zonotope

FLAT = {
    "no generators": np.zeros((2, 0)),
    "zero generators": np.zeros((2, 3)),
    "one segment": np.array([[0.9], [0.9]]),
    "a segment of parallel generators": np.array([[0.3, -0.6, 0.0], [0.1, -0.2, 0.0]]),
    "along an axis": np.array([[0.0, 0.0], [0.5, 0.2]]),
    "box": np.diag([0.9, 0.2]),
    "hexagon": np.array([[0.9, 0.0, 0.9], [0.0, 0.9, 0.9]]),
    "parallel beside others": np.array([[0.9, 0.3, 0.0, 0.1, -0.2], [0.6, 0.2, 0.7, 0.0, 0.0]]),
    "nearly flat": np.array([[1.0, 1.0], [1.0, 1.0 + 1e-7]]),
    "small": 1e-9 * np.array([[0.9, 0.0, 0.9], [0.0, 0.9, 0.9]]),
    "one small generator": np.array([[0.7, 1e-9], [0.2, -1e-9]]),
    "many": np.random.default_rng(4).normal(size=(2, 9)),
}


def distance(center: FloatArray, generators: FloatArray, point: FloatArray) -> float:
    """Of a point from a zonotope, the greater of the two coordinates, by a linear program in units of their size."""
    count, away = generators.shape[1], point - center
    unit = float(max(np.abs(generators).max(initial=0.0), np.abs(away).max()))
    if unit == 0.0:
        return 0.0
    rows = np.block([[generators / unit, -np.ones((2, 1))], [-generators / unit, -np.ones((2, 1))]])
    found = linprog(
        np.append(np.zeros(count), 1.0), A_ub=rows, b_ub=np.concatenate([away, -away]) / unit,
        bounds=[*[(-1, 1)] * count, (0, None)],
        options={"primal_feasibility_tolerance": 1e-10, "dual_feasibility_tolerance": 1e-10},
    )  # fmt: skip
    assert found.fun is not None
    return float(found.fun) * unit


@pytest.mark.parametrize("name", FLAT)
def test_points_are_held_as_linear_programs_say(name: str) -> None:
    generators, center, rng = FLAT[name], np.array([0.4, -1.3]), np.random.default_rng(8)
    count = 60
    beta = rng.uniform(-1, 1, (count, generators.shape[1]))
    beta[::2] = np.sign(beta[::2])
    points = center + beta @ generators.T
    # A third is left where it is, corners among them; others are moved a little or a lot.
    size = 1.0 + np.abs(generators).sum()
    shift = size * rng.normal(size=(count, 2)) * 10.0 ** rng.uniform(-6, 0.5, (count, 1))
    points[count // 3 :] += shift[count // 3 :]
    found = cuts.holds(Zonotope(np.tile(center, (count, 1)), np.tile(generators, (count, 1, 1))), points)
    away = np.array([distance(center, generators, point) for point in points])
    assert found[: count // 3].all()
    # What linear programs are accurate to lies between.
    assert found[away < 1e-10].all()
    assert not found[away > 1e-8].any()
    assert (away > 1e-8).sum() > 5
