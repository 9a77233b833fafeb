"""Simplified sets are the same sets with fewer generators."""

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from reach_server.sets import Direction, Zonotope
from reach_server.sets.redundancy import drop_zero, merge_parallel
from tests.reach_server.ugly import ZONOTOPES, Raw, directions, moderate, named, random_sets


@pytest.mark.parametrize("case", ZONOTOPES, ids=named)
def test_simplified_sets_are_the_same(case: Raw) -> None:
    z = case.zonotope()
    simple = z.simplify()
    d = np.concatenate([directions(case.n, 30), case.G.T])
    rounding = 1e-14 * np.abs(d) @ np.abs(case.G).sum(axis=1)
    reach, before = np.abs(d @ simple.generators).sum(axis=1), np.abs(d @ case.G).sum(axis=1)
    assert (np.abs(reach - before) <= rounding).all()
    assert simple.generators.shape[1] <= case.G.shape[1]
    assert simple.direction is Direction.EXACT


@pytest.mark.parametrize(
    ("name", "count"),
    [
        ("a point with zero generators", 0),
        ("a segment of parallel generators", 1),
        ("a segment along an axis", 1),
        ("one dimension", 1),
        ("equal generators", 2),
        ("a zero generator among others", 2),
        ("huge and tiny", 3),
        ("plain in the plane", 6),
    ],
)
def test_as_few_generators_as_the_set_needs(name: str, count: int) -> None:
    case = next(c for c in ZONOTOPES if c.name == name)
    assert case.zonotope().simplify().generators.shape[1] == count


@moderate
@given(random_sets(rows=0), st.integers(0, 2**32 - 1))
def test_multiples_of_generators_are_merged_in_any_dimension(case: Raw, seed: int) -> None:
    rng = np.random.default_rng(seed)
    base = Zonotope(case.c, case.G).simplify().generators
    # Too small a number has no multiples.
    assume(not ((base != 0) & (np.abs(base) < 1e-290)).any())
    extra = base * rng.choice([-1, 1], base.shape[1]) * rng.uniform(0.1, 10, base.shape[1])
    shuffled = rng.permutation(np.concatenate([base, extra], axis=1), axis=1)
    merged = drop_zero(merge_parallel(shuffled))
    assert merged.shape == base.shape
    np.testing.assert_allclose(np.abs(merged).sum(axis=1), np.abs(shuffled).sum(axis=1), rtol=1e-12)


def test_nearly_parallel_generators_stay_apart() -> None:
    generators = np.array([[1.0, 1.0, 1e12], [1.0, 1.0 + 1e-13, 1e12 + 1.0]])
    assert drop_zero(merge_parallel(generators)).shape == (2, 3)
    # A long generator does not swallow what a short one says about a small coordinate.
    generators = np.array([[1e12, 1e12], [1e-12, -1e-12]])
    assert drop_zero(merge_parallel(generators)).shape == (2, 2)


def test_a_batch_keeps_a_common_shape() -> None:
    generators = np.zeros((3, 2, 4))
    generators[0] = [[1.0, 2.0, 0.0, 0.0], [1.0, 2.0, 0.0, 1.0]]
    generators[1] = [[0.0, 1.0, 0.0, 1.0], [0.0, 0.0, 0.0, 1.0]]
    simple = Zonotope(np.zeros((3, 2)), generators).simplify().generators
    np.testing.assert_array_equal(simple[0], [[3.0, 0.0], [3.0, 1.0]])
    np.testing.assert_array_equal(simple[1], [[1.0, 1.0], [0.0, 1.0]])
    np.testing.assert_array_equal(simple[2], np.zeros((2, 2)))
    assert Zonotope(np.zeros((0, 2)), generators[:0]).simplify().generators.shape == (0, 2, 0)
