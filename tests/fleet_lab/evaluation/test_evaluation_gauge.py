"""The factor that makes coverages equal, against a linear program for each set."""

import numpy as np
import pytest
from scipy.optimize import linprog

from reach_server.numeric.types import FloatArray
from reach_server.sets.gauge import common_factor


def gauge(generators: FloatArray, offset: FloatArray) -> float:
    """min |β|_inf with Gβ = offset."""
    n, g = generators.shape
    bounds = np.concatenate([np.eye(g), -np.eye(g)])
    found = linprog(
        np.append(np.zeros(g), 1.0),
        A_ub=np.column_stack([bounds, -np.ones(2 * g)]),
        b_ub=np.zeros(2 * g),
        A_eq=np.column_stack([generators, np.zeros(n)]),
        b_eq=offset,
        bounds=[(None, None)] * g + [(0, None)],
    )
    assert found.x is not None
    return float(found.x[-1])


@pytest.mark.parametrize("g", [4, 7, 40])
@pytest.mark.parametrize("share", [0.5, 0.99, 1.0])
def test_the_factor_is_that_of_the_linear_programs(g: int, share: float) -> None:
    rng = np.random.default_rng(g)
    generators = rng.normal(size=(120, 4, g)) * np.array([1.0, 0.01, 1.0, 30.0])[:, None] * rng.uniform(0.01, 1, g)
    offset = (generators @ rng.uniform(-1, 1, (120, g, 1)))[..., 0] * rng.uniform(0.1, 1.5, (120, 1))
    exact = np.sort([gauge(a, b) for a, b in zip(generators, offset, strict=True)])[int(np.ceil(share * 120)) - 1]
    found = common_factor(generators, offset, share)
    assert exact * (1 - 1e-6) <= found <= 1.02 * exact


def test_sets_that_are_flat() -> None:
    generators = np.broadcast_to(np.diag([1.0, 0.0, 2.0]), (4, 3, 3))
    offset = np.array([[0.5, 0, 0], [0.1, 0, 1.0], [0, 0, 0], [0, 1e-3, 0]])
    assert common_factor(generators, offset, 0.75) == pytest.approx(0.5, rel=5e-3)
    assert common_factor(generators, offset, 1.0) == np.inf
    # One direction only: what lies beside it is never reached.
    line = np.broadcast_to(np.array([[1.0], [1.0]]), (2, 2, 1))
    assert common_factor(line, np.array([[0.3, 0.3], [0.2, 0.1]]), 0.5) == pytest.approx(0.3, rel=5e-3)
    assert common_factor(line, np.array([[0.3, 0.3], [0.2, 0.1]]), 1.0) == np.inf


def test_scaling_makes_the_coverage_equal() -> None:
    rng = np.random.default_rng(0)
    generators = rng.normal(size=(1000, 3, 9))
    offset = rng.normal(size=(1000, 3)) * 3
    factor = common_factor(generators, offset, 0.9)
    assert common_factor(generators * factor, offset, 0.9) == pytest.approx(1.0, rel=5e-3)
