"""Rescaling, elimination of constraints and simplification: nothing is lost, what is exact stays exact."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from reach_server.sets import ConstrainedZonotope, Direction, SetError, Zonotope, factor_bounds
from reach_server.sets.order_reduction import ReductionMethod
from tests.reach_server.ugly import (
    EMPTY,
    INHABITED,
    ROUNDING,
    Raw,
    assert_holds,
    directions,
    extreme,
    members,
    moderate,
    named,
    of,
    random_sets,
)

inhabited = pytest.mark.parametrize("case", INHABITED[::3], ids=named)


def random_batch(count: int, g: int, rows: int, seed: int = 0) -> ConstrainedZonotope:
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(count, rows, g))
    b = (A @ rng.uniform(-0.5, 0.5, (count, g, 1)))[..., 0]
    return ConstrainedZonotope(np.zeros((count, 2)), rng.normal(size=(count, 2, g)), A, b)


def strip_batch(count: int, g: int, rows: int, seed: int = 0) -> ConstrainedZonotope:
    rng = np.random.default_rng(seed)
    z = Zonotope(np.zeros((count, 2)), rng.normal(size=(count, 2, g - rows)))
    inner = z.sample(rng, 1)[:, 0]
    c = ConstrainedZonotope.from_zonotope(z)
    for _ in range(rows):
        normal = rng.normal(size=(count, 2))
        reach = np.abs((normal[:, None] @ z.generators)[:, 0]).sum(axis=1)
        radius = rng.uniform(0.1, 0.5, count) * reach
        c = c.intersect_strip(normal, (normal * inner).sum(axis=1) + rng.uniform(-0.9, 0.9, count) * radius, radius)
    return c


def assert_same(case: Raw, result: ConstrainedZonotope) -> None:
    """Supports by linear programs agree."""
    ours = of(result)
    for d in directions(case.n, 3):
        found, wanted = extreme(ours, d), extreme(case, d)
        if found is None or wanted is None:
            continue
        reach = case.size * float(np.linalg.norm(d))
        assert found[0] == pytest.approx(wanted[0], abs=ROUNDING * reach)


@inhabited
def test_rescaled_and_simplified_sets_are_the_same(case: Raw) -> None:
    c = case.constrained()
    for result in (c.rescale(), c.simplify()):
        assert not result.is_empty()
        assert result.direction is Direction.EXACT
        assert_same(case, result)
        assert_holds(of(result), members(case, 1), case)


@pytest.mark.parametrize("case", EMPTY, ids=named)
def test_empty_sets_stay_empty(case: Raw) -> None:
    assert case.constrained().simplify().is_empty()
    assert case.constrained().rescale().is_empty()


@inhabited
@pytest.mark.parametrize("count", [0, 1])
def test_fewer_constraints_enclose(case: Raw, count: int) -> None:
    reduced = case.constrained().reduce_constraints(count)
    rows = len(case.A)
    assert reduced.constraint_matrix.shape[-2] == min(count, rows)
    assert reduced.generators.shape[-1] <= case.G.shape[1]
    assert reduced.direction is (Direction.OUTER if rows > count else Direction.EXACT)
    assert_holds(of(reduced), members(case, 2), case)


@moderate
@given(random_sets(rows=4), st.integers(0, 2))
@pytest.mark.slow
def test_random_sets_with_fewer_constraints_enclose(case: Raw, count: int) -> None:
    c, inner = case.constrained(), members(case, 2)
    assert_holds(of(c.reduce_constraints(count)), inner, case)
    assert_holds(of(c.enclosing_zonotope()), inner, case)
    assert_holds(of(c.simplify()), inner, case)
    assert_holds(of(c.rescale()), inner, case)


@pytest.mark.parametrize("method", ["girard", "combastel", "pca", "scott"])
@pytest.mark.parametrize("case", INHABITED[1::5], ids=named)
def test_fewer_generators_enclose(case: Raw, method: ReductionMethod) -> None:
    for order in (1, 2):
        reduced = case.constrained().reduce_order(order, method)
        assert reduced.generators.shape[-1] <= max(order * case.n, case.n + len(case.A))
        assert_holds(of(reduced), members(case, 2), case)


@pytest.mark.parametrize(
    ("batch", "median"),
    [
        (random_batch(60, 12, 4), 1.2),
        (random_batch(30, 30, 4), 1.2),
        (strip_batch(60, 12, 4), 1.05),
        (strip_batch(30, 30, 4), 1.05),
    ],
)
def test_four_constraints_become_one_at_little_cost(batch: ConstrainedZonotope, median: float) -> None:
    exact = batch.area()
    reduced = batch.reduce_constraints(1)
    assert reduced.constraint_matrix.shape[-2] == 1
    growth = reduced.area() / exact
    assert growth.min() >= 1 - 1e-9
    assert np.median(growth) <= median
    assert np.median(batch.keep_newest_constraints(1).area() / exact) > np.median(growth)


def test_enclosing_zonotopes_are_no_larger_than_simpler_ones() -> None:
    for batch in (random_batch(40, 12, 3), strip_batch(40, 12, 3)):
        area = batch.enclosing_zonotope().area()
        assert (area <= Zonotope(batch.center, batch.generators).area() * (1 + 1e-9)).all()
        lower, upper = batch.interval_hull()
        assert (area <= (upper - lower).prod(axis=-1) * (1 + 1e-9)).all()
        assert (area >= batch.area() * (1 - 1e-9)).all()


def test_constraints_go_from_every_set_of_a_batch_by_its_own_ranking() -> None:
    batch = random_batch(6, 10, 3)
    together = batch.reduce_constraints(1)
    for k in range(6):
        one = ConstrainedZonotope(
            batch.center[k], batch.generators[k], batch.constraint_matrix[k], batch.constraint_offset[k]
        )
        np.testing.assert_allclose(one.reduce_constraints(1).area(), together.area()[k], rtol=1e-8)


def test_factors_reach_their_bounds_after_rescaling() -> None:
    batch = random_batch(5, 8, 3).rescale()
    lower, upper = factor_bounds.factor_bounds(batch.constraint_matrix, batch.constraint_offset)
    np.testing.assert_allclose(lower, -1.0, atol=1e-6)
    np.testing.assert_allclose(upper, 1.0, atol=1e-6)


def test_redundant_rows_and_columns_go() -> None:
    rng = np.random.default_rng(0)
    G, A = rng.normal(size=(2, 4)), rng.normal(size=(1, 4))
    b = A @ rng.uniform(-0.5, 0.5, 4)
    zero = np.zeros((2, 1))
    wide = ConstrainedZonotope(
        np.zeros(2),
        np.concatenate([G, zero, -2 * G[:, :1], zero], axis=1),
        np.array([
            [*A[0], 0, *(-2 * A[0, :1]), 0],
            [*(3 * A[0]), 0, *(-6 * A[0, :1]), 0],
            [0] * 7,
            [0.1, 0.2, 0, 0, 0, 0, 5],
        ]),
        np.array([b[0], 3 * b[0], 0, 1.0]),
    )  # fmt: skip
    tidy = wide.simplify()
    assert tidy.constraint_matrix.shape == (1, 4)
    assert_same(of(wide), tidy)


def test_a_batch_keeps_what_its_largest_set_needs() -> None:
    c = ConstrainedZonotope(np.zeros((2, 2)), np.eye(2), np.zeros((0, 2)), np.zeros(0))
    cut = c.intersect_strip([1.0, 0.0], np.zeros(2), np.array([0.5, 5.0])).simplify()
    assert cut.constraint_matrix.shape == (2, 1, 3)
    np.testing.assert_allclose(cut.area(), [2.0, 4.0], rtol=1e-9)
    apart = c.intersect_strip([1.0, 0.0], np.full(2, 3.0), 1.0).simplify()
    assert apart.is_empty().all()


def test_counts_are_checked() -> None:
    with pytest.raises(SetError, match="count is -1"):
        random_batch(1, 5, 2).reduce_constraints(-1)
    with pytest.raises(SetError, match=r"count is 1\.5"):
        random_batch(1, 5, 2).reduce_constraints(1.5)  # type: ignore[arg-type]
