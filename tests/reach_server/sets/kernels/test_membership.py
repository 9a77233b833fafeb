"""Membership of batches against linear programs."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from reach_server.sets.kernels.membership import contains, reach
from tests.reach_server.ugly import Raw as Set
from tests.reach_server.ugly import directions, gap, members, moderate, random_sets


@moderate
@given(random_sets(), st.integers(0, 2**32 - 1))
def test_members_are_found_and_others_are_not(case: Set, seed: int) -> None:
    inside = members(case, 1)
    for point in inside[:4]:
        assert contains(case.c, case.G, case.A, case.b, inside.mean(axis=0) * 1e-5 + (1 - 1e-5) * point)
    direction = directions(case.n, 1, seed)[-1]
    point = case.c + direction * case.size * np.random.default_rng(seed).uniform(0, 1.5)
    distance = gap(case, point)
    found = bool(contains(case.c, case.G, case.A, case.b, point))
    if distance > 1e-3:
        assert not found
    if found:
        assert distance <= 1e-6


def test_a_batch_mixes_cheap_answers_and_linear_programs() -> None:
    rng = np.random.default_rng(0)
    G = rng.normal(size=(40, 2, 6))
    A = rng.normal(size=(40, 1, 6))
    factor = rng.uniform(-1, 1, (40, 6))
    factor[:20] = np.where(rng.random((20, 6)) < 0.7, np.sign(factor[:20]), factor[:20])
    b = (A @ factor[..., None])[..., 0]
    c = rng.normal(size=(40, 2))
    points = c + (G @ factor[..., None])[..., 0]
    assert contains(c, G, A, b, points).all()
    stretched = c + 20 * (points - c)
    expected = [gap(Set("", c[i], G[i], A[i], b[i]), stretched[i]) <= 1e-7 for i in range(40)]
    np.testing.assert_array_equal(contains(c, G, A, b, stretched), expected)
    assert contains(c[:0], G[:0], A[:0], b[:0], points[:0]).shape == (0,)


@moderate
@given(random_sets(), st.integers(0, 2**32 - 1))
@pytest.mark.slow
def test_factors_reach_the_points_that_they_are_of(case: Set, seed: int) -> None:
    inside = members(case, 1)
    points = np.concatenate([inside[:3], [case.c + 2 * case.size * directions(case.n, 1, seed)[-1]]])
    found, factors = reach(case.c, case.G, case.A, case.b, points)
    assert factors.shape == (len(points), case.G.shape[1])
    np.testing.assert_array_equal(found, contains(case.c, case.G, case.A, case.b, points))
    for point, met, beta in zip(points, found, factors, strict=True):
        if not met:
            assert np.isnan(beta).all()
            continue
        assert (np.abs(beta) <= 1).all()
        np.testing.assert_allclose(case.c + case.G @ beta, point, atol=1e-6 * case.size)
        np.testing.assert_allclose(case.A @ beta, case.b, atol=1e-6 * (np.abs(case.A).sum() + 1e-300))


def test_a_point_is_met_up_to_rounding() -> None:
    third = np.array([0.1 + 0.2])
    none = np.zeros((0, 0))
    assert contains(np.array([0.3]), np.zeros((1, 0)), none, np.zeros(0), third)
    assert contains(np.array([0.3]), np.zeros((1, 2)), np.zeros((0, 2)), np.zeros(0), third)
    assert not contains(np.array([0.3]), np.zeros((1, 2)), np.zeros((0, 2)), np.zeros(0), np.array([0.3 + 1e-9]))
