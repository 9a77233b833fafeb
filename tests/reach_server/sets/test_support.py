"""Certified supports and emptiness: never below the truth whatever the solver does, tight, and proved by weights."""

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import linprog

from reach_server.numeric.types import FloatArray
from reach_server.sets import ConstrainedZonotope, support
from reach_server.sets.kernels import simplex
from tests.reach_server.ugly import CONSTRAINED, EMPTY, INHABITED, Raw, directions, extreme, moderate, named


def problem(rng: np.random.Generator, rows: int, g: int) -> Raw:
    A = rng.normal(size=(rows, g))
    return Raw("", rng.normal(size=2), rng.normal(size=(2, g)), A, A @ rng.uniform(-0.7, 0.7, g))


def exact_bound(case: Raw, d: FloatArray, y: FloatArray) -> Fraction:
    """``d·c + b·y + |Gᵀd - Aᵀy|₁`` in rational numbers."""
    c, G, A, b, d_, y_ = (
        [[Fraction(v) for v in row] for row in np.atleast_2d(a)] for a in (case.c, case.G, case.A, case.b, d, y)
    )
    total = sum((u * v for u, v in zip(d_[0], c[0], strict=True)), Fraction(0))
    total += sum((u * v for u, v in zip(b[0], y_[0], strict=True)), Fraction(0))
    for j in range(case.G.shape[1]):
        rest = sum((d_[0][i] * G[i][j] for i in range(case.n)), Fraction(0))
        total += abs(rest - sum((y_[0][i] * A[i][j] for i in range(len(case.A))), Fraction(0)))
    return total


@pytest.mark.parametrize(("rows", "g"), [(0, 4), (1, 5), (2, 3), (3, 4), (4, 40), (8, 40), (6, 6), (20, 60)])
def test_bounds_are_above_the_true_support_and_close(rows: int, g: int) -> None:
    rng = np.random.default_rng(rows)
    excess = []
    for _ in range(8):
        case = problem(rng, rows, g)
        d = directions(2, 2)
        bound = support.constrained_support(case.c, case.G, case.A, case.b, d)
        for one, value in zip(d, bound, strict=True):
            found = extreme(case, one)
            assert found is not None
            excess.append((value - found[0]) / np.abs(one @ case.G).sum())
    assert min(excess) > -1e-12
    assert max(excess) < 1e-9


@pytest.mark.parametrize("case", INHABITED, ids=named)
def test_weights_prove_the_bounds_in_exact_arithmetic(case: Raw) -> None:
    d = directions(case.n, 2)
    certificate = case.constrained().support_certificate(d)
    np.testing.assert_array_equal(certificate.bound, case.constrained().support(d))
    for one, bound, y in zip(d, certificate.bound, certificate.weights, strict=True):
        exact = exact_bound(case, one, y)
        assert exact <= Fraction(bound)
        assert bound - float(exact) <= 1e-12 * (case.size + np.abs(case.c).sum()) * np.abs(one).sum()


@pytest.mark.parametrize("case", EMPTY, ids=named)
def test_weights_prove_emptiness_in_exact_arithmetic(case: Raw) -> None:
    found = case.constrained().emptiness_certificate()
    assert found.empty
    zero = Raw("", np.zeros(case.n), 0 * case.G, case.A, case.b)
    assert exact_bound(zero, np.zeros(case.n), found.weights) < 0
    certificate = case.constrained().support_certificate(directions(case.n, 1))
    assert np.isneginf(certificate.bound).all()
    for y in certificate.weights:
        assert exact_bound(zero, np.zeros(case.n), y) < 0


@pytest.mark.parametrize("case", INHABITED, ids=named)
def test_inhabited_sets_get_no_certificate(case: Raw) -> None:
    found = case.constrained().emptiness_certificate()
    assert not found.empty
    np.testing.assert_array_equal(found.weights, 0.0)


@moderate
@given(st.integers(0, 2**32 - 1), st.integers(0, 20))
def test_every_number_of_iterations_gives_a_bound(seed: int, iterations: int) -> None:
    rng = np.random.default_rng(seed)
    case = problem(rng, int(rng.integers(1, 5)), int(rng.integers(5, 12)))
    d = directions(2, 1)[-1:]
    found = extreme(case, d[0])
    assert found is not None
    bound = support.constrained_support(case.c, case.G, case.A, case.b, d, iterations)
    assert bound[0] >= found[0] - 1e-12 * np.abs(case.G).sum()


@moderate
@given(st.integers(0, 2**32 - 1))
@pytest.mark.slow
def test_degenerate_programs_are_solved(seed: int) -> None:
    """Small whole numbers: ties in costs, dependent rows, vertices where many bounds meet."""
    rng = np.random.default_rng(seed)
    for _ in range(5):
        rows, g = int(rng.integers(1, 6)), int(rng.integers(1, 15))
        A = rng.integers(-1, 2, (rows, g)).astype(float)
        b = A @ rng.choice([-1.0, -0.5, 0.0, 0.5, 1.0], g)
        costs = rng.integers(-1, 2, (3, g)).astype(float)
        found = support.solve(np.zeros(3), costs, A, b, np.eye(3))
        assert (found.status == simplex.OPTIMAL).all()
        for cost, bound, factors in zip(costs, found.bound, found.factors, strict=True):
            program = linprog(-cost, A_eq=A, b_eq=b, bounds=(-1, 1), method="highs")
            assert program.fun is not None
            assert bound == pytest.approx(-program.fun, abs=1e-9)
            assert cost @ factors == pytest.approx(bound, abs=1e-9)
            np.testing.assert_allclose(A @ factors, b, atol=1e-9)
            assert np.abs(factors).max() <= 1.0


def test_badly_scaled_and_nearly_dependent_rows_cost_tightness_only() -> None:
    rng = np.random.default_rng(11)
    for distance in (1e-3, 1e-6, 1e-9, 1e-12, 1e-15):
        case = problem(rng, 4, 12)
        A = np.concatenate([case.A, case.A[:2] + distance * rng.normal(size=(2, 12))])
        factor = rng.uniform(-0.9, 0.9, 12)
        near = Raw("", case.c, case.G, A, A @ factor)
        d = directions(2, 3)
        bound = support.constrained_support(near.c, near.G, near.A, near.b, d)
        assert not support.emptiness_certificate(near.A, near.b)
        assert (bound >= d @ (near.c + near.G @ factor)).all()
        assert (bound <= support.constrained_support(case.c, case.G, case.A, case.A @ factor, d) + 1e-9).all()


@moderate
@given(st.integers(0, 2**32 - 1), st.sampled_from([1e-9, 1.0, 1e9]))
def test_sets_on_the_verge_of_emptiness_are_not_called_empty(seed: int, scale: float) -> None:
    rng = np.random.default_rng(seed)
    rows, g = int(rng.integers(1, 6)), int(rng.integers(1, 20))
    A = np.asarray(rng.integers(-3, 4, (50, rows, g)) * 0.1 * scale, dtype=np.float64)
    corner = np.where(A.sum(axis=1) >= 0, 1.0, -1.0)
    b = (A @ corner[..., None])[..., 0]
    assert not support.emptiness_certificate(A, b).any()


@pytest.mark.parametrize("scale", [1e-12, 1e-3, 1.0, 1e3, 1e12])
@pytest.mark.parametrize("excess", [1e-5, 0.1, 10.0])
def test_empty_sets_are_found_in_every_unit(scale: float, excess: float) -> None:
    rng = np.random.default_rng(3)
    A = rng.normal(size=(100, 3, 12)) * scale
    y = rng.normal(size=(100, 3))
    reach = np.abs(np.swapaxes(A, 1, 2) @ y[..., None]).sum(axis=(1, 2))
    b = -y * ((1 + excess) * reach / (y**2).sum(axis=1))[:, None]
    assert support.emptiness_certificate(A, b).all()


def test_the_weights_name_the_rows_that_conflict() -> None:
    c = ConstrainedZonotope(np.zeros(2), np.eye(2), np.zeros((0, 2)), np.zeros(0))
    c = c.intersect_strip([1.0, 1.0], 0.0, 1.0).intersect_strip([1.0, 0.0], 0.8, 0.1)
    c = c.intersect_strip([0.0, 1.0], 0.8, 0.1)
    weights = np.abs(c.emptiness_certificate().weights)
    assert (weights > 0.1).all()
    apart = c.intersect_strip([1.0, -1.0], 0.0, 1.0)
    assert np.abs(apart.emptiness_certificate().weights[3]) < 1e-9


def test_scaling_a_problem_scales_its_bound() -> None:
    case = problem(np.random.default_rng(0), 3, 10)
    d = directions(2, 3)
    zero = np.zeros(2)
    bound = support.constrained_support(zero, case.G, case.A, case.b, d)
    for scale in (2.0**-40, 2.0**40):
        np.testing.assert_allclose(
            support.constrained_support(zero, scale * case.G, case.A, case.b, d), scale * bound, rtol=1e-12
        )


def test_many_directions_of_one_set_are_each_tight() -> None:
    """The basis is handed on from direction to direction, and factorised again on the way."""
    case = problem(np.random.default_rng(5), 6, 30)
    d = np.random.default_rng(6).normal(size=(300, 2))
    together = support.constrained_support(case.c, case.G, case.A, case.b, d)
    alone = [support.constrained_support(case.c, case.G, case.A, case.b, one[None])[0] for one in d]
    np.testing.assert_allclose(together, alone, rtol=1e-12)


@pytest.mark.parametrize("case", CONSTRAINED[::5], ids=named)
def test_shared_and_own_arrays_give_the_same(case: Raw) -> None:
    """A batch may share some of its arrays, and directions may have batch axes of their own."""
    d = np.random.default_rng(0).normal(size=(3, 2, case.n))
    shared = support.solve(case.c, case.G, case.A, case.b, d)
    c, G, A, b = (np.broadcast_to(a, (3, *a.shape)) for a in (case.c, case.G, case.A, case.b))
    own = support.solve(c, G, A, b, d)
    for k in range(3):
        alone = support.solve(case.c, case.G, case.A, case.b, d[k])
        for found in (shared, own):
            np.testing.assert_array_equal(found.bound[k], alone.bound)
            np.testing.assert_array_equal(found.status[k], alone.status)
