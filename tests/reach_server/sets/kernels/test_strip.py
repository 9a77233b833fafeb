"""Compiled cuts against formulas written out in NumPy, and against what they must hold."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from reach_server.numeric.types import FloatArray
from reach_server.sets.halfspace import intersect_strip, log_size, narrow
from reach_server.sets.kernels import strip as kernels
from reach_server.sets.kernels.strip import ACTED, MISSED, WORK, narrow_one
from tests.reach_server.ugly import ZONOTOPES, Raw, assert_holds, members, moderate, named


def narrowed(
    case: Raw, strips: list[tuple[FloatArray, float, float]], room: int, plane: tuple[int, int] = (-1, -1)
) -> tuple[Raw, list[int], bool]:
    """The set after its cuts, the flags of the strips, and whether it is empty."""
    g = case.G.shape[1]
    center, generators = case.c.copy(), np.concatenate([case.G, np.zeros((case.n, room))], axis=1)
    flags, work = np.zeros(len(strips), dtype=np.uint8), np.zeros((WORK, max(case.n, g + room)))
    used, empty = narrow_one(
        center, generators, g, np.array([s[0] for s in strips]), np.array([s[1] for s in strips]),
        np.array([s[2] for s in strips]), np.ones(len(strips), dtype=bool), *plane, False, flags, work,
    )  # fmt: skip
    assert not generators[:, used:].any()
    return Raw("", center, generators[:, :used], np.zeros((0, used)), np.zeros(0)), flags.tolist(), empty


def oracle(center: FloatArray, generators: FloatArray, normal: FloatArray, low: float, high: float) -> FloatArray:
    """Generators after the best of all λ that ``tight`` tries, by the plain formulas."""
    heights, middle = normal @ generators, normal @ center
    low, high = max(low, middle - np.abs(heights).sum()), min(high, middle + np.abs(heights).sum())
    radius = (high - low) / 2
    options = [np.zeros(len(center)), generators @ heights / (heights @ heights + radius**2)]
    options += [generators[:, j] / heights[j] for j in np.argsort(-np.abs(heights))[: kernels.CANDIDATES]]
    found = [np.column_stack([generators - np.outer(o, heights), o * radius]) for o in options]
    sizes = [
        np.log(4 * sum(abs(np.linalg.det(f[:2][:, [i, j]])) for i in range(f.shape[1]) for j in range(i)))
        + np.log(2 * np.abs(f[2:]).sum(axis=1)).sum()
        for f in found
    ]
    return found[int(np.argmin(sizes))]


@moderate
@given(st.integers(0, 2**32 - 1), st.integers(2, 4), st.integers(2, 11), st.booleans())
def test_a_cut_is_the_best_of_those_tried(seed: int, n: int, g: int, in_plane: bool) -> None:
    rng = np.random.default_rng(seed)
    center, generators, normal = rng.normal(size=n), rng.normal(size=(n, g)), rng.normal(size=n)
    if in_plane:
        normal[2:] = 0.0
    middle, reach = normal @ center, np.abs(normal @ generators).sum()
    low, high = middle + np.sort(rng.uniform(-0.9, 0.9, 2)) * reach
    found = intersect_strip(center, generators, normal, low, high, plane=(0, 1))[1]
    expected = oracle(center, generators, normal, low, high)
    assert log_size(found, (0, 1)) == pytest.approx(log_size(expected, (0, 1)), abs=1e-9)


@pytest.mark.parametrize("room", [0, 1, 4])
@pytest.mark.parametrize("case", ZONOTOPES, ids=named)
def test_cuts_hold_what_obeys_them(case: Raw, room: int) -> None:
    rng = np.random.default_rng(case.n)
    for _ in range(3):
        strips = []
        for _ in range(2):
            normal = rng.normal(size=case.n)
            reach = np.abs(normal @ case.G).sum()
            low, high = normal @ case.c + np.sort(rng.uniform(-1, 1, 2)) * reach
            strips.append((normal, float(low), float(high) if rng.random() < 0.6 else np.inf))
        found, flags, empty = narrowed(case, strips, room)
        points = members(case, 3, strips)
        if len(points):
            assert not empty
            assert not any(flag & MISSED for flag in flags)
            assert_holds(found, points, case)


@moderate
@given(st.integers(0, 2**32 - 1), st.integers(1, 6))
def test_many_cuts_are_never_larger_and_lifted_coordinates_go_along(seed: int, count: int) -> None:
    rng = np.random.default_rng(seed)
    center, generators = rng.normal(size=5), rng.normal(size=(5, 7))
    case = Raw("", center, generators, np.zeros((0, 7)), np.zeros(0))
    factors = np.sign(rng.uniform(-1, 1, (3000, 7))) * rng.uniform(0.2, 1, (3000, 7))
    points = center + factors @ generators.T
    strips: list[tuple[FloatArray, float, float]] = []
    inside = np.ones(len(points), dtype=bool)
    for _ in range(count):
        # Strips speak about the first three coordinates only.
        normal = rng.normal(size=3)
        heights = points[:, :3] @ normal
        low, high = np.quantile(heights, np.sort(rng.uniform(0, 1, 2)))
        strips.append((normal, low, high))
        inside &= (low <= heights) & (heights <= high)
    found, _, empty = narrowed(case, strips, 2 * count, (0, 1))
    assert log_size(found.G, (0, 1)) <= log_size(generators, (0, 1)) + 1e-9
    assert not (empty and inside.any())
    for d in rng.normal(size=(20, 5)):
        reach = d @ found.c + np.abs(d @ found.G).sum()
        assert (points[inside] @ d <= reach + 1e-9).all()


def test_a_strip_that_misses_leaves_the_set_as_it_is() -> None:
    case = Raw("", np.zeros(2), np.eye(2), np.zeros((0, 2)), np.zeros(0))
    x = np.array([1.0, 0.0])
    found, flags, empty = narrowed(case, [(x, 2.0, 3.0), (x, -0.5, 0.5), (x, -5.0, 5.0)], 6)
    assert (flags, empty) == ([MISSED, ACTED, 0], True)
    assert np.abs(found.G[0]).sum() == pytest.approx(0.5)


def test_what_is_not_a_number_is_not_empty() -> None:
    for value in (np.nan, np.inf):
        for c, G in ((np.array([value, 0.0]), np.eye(2)), (np.zeros(2), np.array([[value, 0.0], [0.0, 1.0]]))):
            found = narrow(c, G, np.eye(2)[:1], np.array([-0.1]), np.array([0.1]), np.ones(1, dtype=bool))
            assert not (found.acted & MISSED).any()


def test_sets_of_a_batch_do_not_depend_on_each_other() -> None:
    rng = np.random.default_rng(3)
    center, generators = rng.normal(size=(40, 4)), rng.normal(size=(40, 4, 9))
    normals, active = rng.normal(size=(3, 4)), rng.random((40, 3)) < 0.7
    bounds = np.full(3, -1.0), np.full(3, 1.0)
    whole = narrow(center, generators, normals, *bounds, active, plane=(0, 1))
    for row in (0, 17, 39):
        alone = narrow(center[row], generators[row], normals, *bounds, active[row], plane=(0, 1))
        np.testing.assert_array_equal(alone.center, whole.center[row])
        np.testing.assert_array_equal(alone.generators, whole.generators[row])
        np.testing.assert_array_equal(alone.acted, whole.acted[row])
