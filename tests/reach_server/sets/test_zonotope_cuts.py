"""Cut zonotopes: no member that obeys a strip is lost, and a tight cut is never larger."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from reach_server.numeric.types import FloatArray
from reach_server.sets import Zonotope
from reach_server.sets.halfspace import StripMethod
from tests.reach_server.ugly import (
    ROUNDING,
    ZONOTOPES,
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

every = pytest.mark.parametrize("case", ZONOTOPES, ids=named)
methods = pytest.mark.parametrize("method", ["tight", "frobenius"])


def strips_of(case: Raw) -> list[tuple[FloatArray, float, float]]:
    """Strips that cut a set on one side, on both, hardly, at its border, at one point, and not at all."""
    found: list[tuple[FloatArray, float, float]] = []
    axis, random = directions(case.n, 1, seed=3)[[case.n, -1]]
    for normal in (axis, random):
        middle = float(normal @ case.c)
        reach = max(float(np.abs(normal @ case.G).sum()), ROUNDING * case.size)
        for low, high in [
            (-0.3, 0.2), (-2, 0.1), (-0.999999, 2), (0.5, 0.5), (0.9, np.inf), (-np.inf, -0.5), (1.0, 1.5),
        ]:  # fmt: skip
            found.append((normal, middle + low * reach, middle + high * reach))
    return found


def cut(z: Zonotope, strip: tuple[FloatArray, float, float], method: StripMethod) -> Zonotope:
    normal, lower, upper = strip
    if np.isinf(lower):
        return z.intersect_halfspace(normal, upper, method)
    if np.isinf(upper):
        return z.intersect_halfspace(-normal, -lower, method)
    return z.intersect_strip(normal, (lower + upper) / 2, (upper - lower) / 2, method)


@every
@methods
def test_a_cut_keeps_every_member_that_obeys_it(case: Raw, method: StripMethod) -> None:
    for strip in strips_of(case):
        result = of(cut(case.zonotope(), strip, method))
        assert_holds(result, members(case, 2, [strip]), case)


@every
def test_a_tight_cut_is_never_larger_and_misses_nothing_else(case: Raw) -> None:
    z = case.zonotope()
    for strip in strips_of(case):
        normal, lower, upper = strip
        result = cut(z, strip, "tight")
        if case.n <= 2:
            # A flat set is cut by its widths; the area of what is left is zero up to rounding.
            assert result.volume() <= z.volume() * (1 + 1e-9) + 1e-12 * case.size**case.n
            wide = [np.abs(of(one).G).sum(axis=1).prod() for one in (result, z)]
            assert z.volume() > 0 or wide[0] <= wide[1] * (1 + 1e-9)
        if np.isfinite(lower) and np.isfinite(upper):
            missed = z.misses_strip(normal, (lower + upper) / 2, (upper - lower) / 2)
            assert not missed or extreme(case, normal, [strip]) is None
        # A strip that holds on the whole set leaves it as it is.
        reach = float(np.abs(normal @ case.G).sum())
        unchanged = z.intersect_strip(normal, float(normal @ case.c), 2 * reach + 1)
        np.testing.assert_array_equal(unchanged.generators[:, :-1], case.G)
        np.testing.assert_array_equal(unchanged.center, case.c)


def test_a_tight_cut_of_a_segment_shortens_it() -> None:
    z = Zonotope(np.zeros(3), np.array([[1.0], [0.5], [0.0]])).intersect_strip([1, 0, 0], 0.0, 0.25)
    lower, upper = z.interval_hull()
    np.testing.assert_allclose(upper, [0.25, 0.125, 0.0], atol=1e-12)
    np.testing.assert_allclose(lower, [-0.25, -0.125, 0.0], atol=1e-12)


@every
def test_strips_beyond_the_set_are_missed(case: Raw) -> None:
    z = case.zonotope()
    for normal in directions(case.n, 2):
        reach = float(np.abs(normal @ case.G).sum()) + 1e-6 * case.size + 1e-8 * float(np.abs(case.c).sum())
        far = float(normal @ case.c) + 4 * reach
        assert z.misses_strip(normal, far, reach)
        unchanged = z.intersect_strip(normal, far, reach)
        np.testing.assert_array_equal(unchanged.center, case.c)


@moderate
@given(random_sets(rows=0), st.integers(0, 2**32 - 1), st.sampled_from(["tight", "frobenius"]))
@pytest.mark.slow
def test_random_cuts_lose_no_member(case: Raw, seed: int, method: StripMethod) -> None:
    rng = np.random.default_rng(seed)
    normal = rng.normal(size=case.n)
    a, b = np.sort(rng.uniform(-1.2, 1.2, 2)) * np.abs(normal @ case.G).sum() + normal @ case.c
    strip = (normal, float(a), float(b))
    z = case.zonotope()
    inside = members(case, 4, [strip])
    result = cut(z, strip, method)
    assert_holds(of(result), inside, case)
    if z.misses_strip(normal, (a + b) / 2, (b - a) / 2):
        assert not len(inside)
    if method == "tight" and case.n <= 2:
        assert result.volume() <= z.volume() * (1 + 1e-9)


def test_an_infinite_strip_changes_nothing_beside_one_that_cuts() -> None:
    z = Zonotope(np.zeros(2), np.eye(2))
    result = z.intersect_strip([1.0, 0.0], 0.0, np.array([0.5, np.inf]))
    np.testing.assert_allclose(result.interval_hull()[1], [[0.5, 1.0], [1.0, 1.0]])


@pytest.mark.parametrize("bound", [-np.inf, np.inf])
def test_half_spaces_at_infinity(bound: float) -> None:
    z = Zonotope(np.zeros(2), np.eye(2)).intersect_halfspace([1.0, 0.0], bound)
    np.testing.assert_allclose(z.interval_hull()[1], [1.0, 1.0])
