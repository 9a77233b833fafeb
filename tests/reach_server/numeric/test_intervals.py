"""Interval arithmetic against exact fractions: what comes back holds the true result."""

import operator
from collections.abc import Callable
from fractions import Fraction
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from reach_server.numeric.types import FloatArray
from reach_server.sets import Interval, SetError
from tests.reach_server.numeric.strategies import numbers
from tests.reach_server.ugly import moderate


@st.composite
def intervals(draw: st.DrawFn) -> Interval:
    low, high = sorted((draw(numbers), draw(numbers)))
    return Interval(np.array(low), np.array(high))


def holds(interval: Interval, value: Fraction) -> bool:
    """Compared as fractions: floats would round."""
    low, high = float(interval.lower), float(interval.upper)
    return (low == -np.inf or Fraction(low) <= value) and (high == np.inf or value <= Fraction(high))


def bounds(interval: Interval) -> tuple[float, float]:
    return float(interval.lower), float(interval.upper)


def ends(interval: Interval) -> list[Fraction]:
    low, high = Fraction(float(interval.lower)), Fraction(float(interval.upper))
    return [low, high, low + (high - low) / 3]


@pytest.mark.parametrize("op", [operator.add, operator.sub, operator.mul], ids=lambda op: str(op.__name__))
@moderate
@given(a=intervals(), b=intervals())
def test_operations_hold_the_exact_results(op: Callable[[Any, Any], Any], a: Interval, b: Interval) -> None:
    result = op(a, b)
    for x in ends(a):
        for y in ends(b):
            assert holds(result, op(x, y))


@moderate
@given(a=intervals(), b=intervals())
def test_quotients_hold_the_exact_results(a: Interval, b: Interval) -> None:
    if b.lower <= 0 <= b.upper:
        with pytest.raises(SetError, match="divisor holds zero"):
            a / b
        return
    for x in ends(a):
        for y in ends(b):
            assert holds(a / b, x / y)


@moderate
@given(a=intervals())
def test_squares_and_sizes_hold_the_exact_results(a: Interval) -> None:
    for x in ends(a):
        assert holds(a.sqr(), x * x)
        assert holds(abs(a), abs(x))
        assert holds(-a, -x)
        assert abs(x - Fraction(float(a.midpoint))) <= Fraction(float(a.radius))
    assert a.sqr().lower >= 0
    assert abs(a).lower >= 0
    if np.isfinite(a.width):
        assert Fraction(float(a.width)) >= Fraction(float(a.upper)) - Fraction(float(a.lower))


@moderate
@given(st.lists(intervals(), min_size=1, max_size=6), st.data())
def test_sums_and_products_with_matrices_hold_the_exact_results(parts: list[Interval], data: st.DataObject) -> None:
    vector = Interval(np.array([p.lower for p in parts]), np.array([p.upper for p in parts]))
    assert holds(vector.sum(), sum((Fraction(float(v)) for v in vector.lower), Fraction(0)))
    assert holds(vector.sum(), sum((Fraction(float(v)) for v in vector.upper), Fraction(0)))
    row = np.array(data.draw(st.lists(numbers, min_size=len(parts), max_size=len(parts))))
    image = vector.linear_map(row[None, :])
    assert image.shape == (1,)
    for pick in range(3):
        exact = sum((Fraction(r) * ends(p)[pick] for r, p in zip(row.tolist(), parts, strict=True)), Fraction(0))
        assert holds(image[0], exact)
        assert holds((Interval.of(row[None, :]) @ vector[:, None])[0, 0], exact)
        assert holds((row[None, :] @ vector[:, None])[0, 0], exact)


def test_what_needs_no_rounding_is_not_rounded() -> None:
    a = Interval(np.array([1.0, 0.0]), np.array([2.0, 0.0]))
    total, zero = a + 1.0, a * 0.0
    np.testing.assert_array_equal([total.lower, total.upper], [[2.0, 1.0], [3.0, 1.0]])
    np.testing.assert_array_equal([zero.lower, zero.upper], np.zeros((2, 2)))
    single = a[:1].sum()
    assert bounds(single) == (1.0, 2.0)


def test_unbounded_intervals_stay_sound() -> None:
    line = Interval(np.array(-np.inf), np.array(np.inf))
    up = Interval(np.array(1.0), np.array(np.inf))
    for result, low, high in [
        (line + 1.0, -np.inf, np.inf),
        (line - line, -np.inf, np.inf),
        (line * 0.0, 0.0, 0.0),
        (line * up, -np.inf, np.inf),
        (up.sqr(), None, np.inf),
        (1.0 / up, 0.0, None),
        (up / up, 0.0, np.inf),
        (up / -up, -np.inf, 0.0),
        (abs(line), 0.0, np.inf),
    ]:
        assert low is None or result.lower <= low
        assert high is None or result.upper >= high
    assert (1.0 / up).upper >= 1.0
    both = Interval(np.array([-np.inf, 0.0]), np.array([0.0, np.inf])).sum()
    assert bounds(both) == (-np.inf, np.inf)
    large = Interval(np.array(1e308), np.array(1e308)) * 10.0
    assert large.upper == np.inf
    assert np.isfinite(large.lower)
    much = Interval(np.full(4, 1e308), np.full(4, 1e308)).sum()
    assert much.upper == np.inf
    assert much.lower <= 1e308


def test_midpoint_radius_and_width_of_intervals_without_end_and_of_empty_ones() -> None:
    low = np.array([0.0, -np.inf, -np.inf, np.inf, -1e308, -np.inf, np.inf])
    high = np.array([np.inf, 3.0, np.inf, -np.inf, 1e308, -np.inf, np.inf])
    with np.errstate(all="raise"):
        a = Interval(low, high)
        midpoint, radius, width = a.midpoint, a.radius, a.width
    np.testing.assert_array_equal(midpoint, [0.0, 3.0, 0.0, np.nan, 0.0, 0.0, 0.0])
    np.testing.assert_array_equal(radius, [np.inf, np.inf, np.inf, np.nan, 1e308, np.inf, np.inf])
    np.testing.assert_array_equal(width, [np.inf, np.inf, np.inf, -np.inf, np.inf, np.inf, np.inf])
    assert Interval.empty().width == -np.inf


@moderate
@given(a=intervals(), b=intervals())
def test_products_and_quotients_are_next_to_the_exact_ones_and_keep_their_sign(a: Interval, b: Interval) -> None:
    results = [(a * b, operator.mul), (a.sqr(), lambda x, y: x * x)]
    if not b.lower <= 0 <= b.upper:
        results.append((a / b, operator.truediv))
    for found, op in results:
        values = [op(x, y) for x in ends(a)[:2] for y in ends(b)[:2]]
        if op is results[1][1] and a.lower <= 0 <= a.upper:
            values.append(Fraction(0))
        assert_beyond(float(found.lower), min(values), -1)
        assert_beyond(float(found.upper), max(values), 1)


def assert_beyond(found: float, exact: Fraction, side: int) -> None:
    """``found`` is at most 2 ulps outside of ``exact``, on the same side of 0, and 0 where that is."""
    assert found == 0 or exact * Fraction(np.sign(found)) > 0
    if not np.isfinite(found):
        assert abs(exact) > Fraction(float(np.finfo(np.float64).max)) * (1 - Fraction(1, 2**52))
    elif abs(exact) < Fraction(float(np.finfo(np.float64).max)):
        assert 0 <= side * (Fraction(found) - exact) <= 2 * Fraction(float(np.spacing(abs(float(exact)))))


def test_empty_intervals_are_values() -> None:
    empty, unit = Interval.empty((2,)), Interval(np.zeros(2), np.ones(2))
    assert empty.is_empty().all()
    assert not unit.is_empty().any()
    for result in (
        empty + unit, unit - empty, empty * unit, empty * 0.0, unit / empty, empty.sqr(), abs(empty), -empty,
        unit.intersection(empty), empty.sum(), empty.linear_map(np.eye(2)), unit.intersection(unit + 3.0),
    ):  # fmt: skip
        assert result.is_empty().all()
    mixed = Interval(np.array([np.inf, 0.0]), np.array([-np.inf, 1.0])) + 1.0
    np.testing.assert_array_equal(mixed.is_empty(), [True, False])
    hull = empty.hull(unit)
    np.testing.assert_array_equal([hull.lower, hull.upper], [unit.lower, unit.upper])
    assert unit.contains(empty).all()
    assert not empty.contains(unit).any()


def test_hull_intersection_and_containment() -> None:
    a, b = Interval(np.array(0.0), np.array(2.0)), Interval(np.array(1.0), np.array(3.0))
    assert bounds(a.hull(b)) == (0.0, 3.0)
    assert bounds(a.intersection(b)) == (1.0, 2.0)
    assert a.contains(2.0)
    assert not a.contains(np.nextafter(2.0, 3.0))
    assert a.hull(b).contains(a)
    assert not a.contains(b)


@pytest.mark.parametrize("shape", [(), (3,), (2, 3), (0,)], ids=str)
def test_batches_give_what_single_ones_give(shape: tuple[int, ...]) -> None:
    rng = np.random.default_rng(0)
    low = rng.normal(size=(*shape, 4))
    vector, matrix = Interval(low, low + 1.0), rng.normal(size=(*shape, 3, 4))

    def results(v: Interval, m: FloatArray) -> list[Interval]:
        return [v + v, v * v, v.sqr(), v.linear_map(m), m @ v[..., :, None], v / (abs(v) + 1.0)]

    whole = results(vector, matrix)
    for place in np.ndindex(*shape):
        for one, every in zip(results(vector[place], matrix[place]), whole, strict=True):
            np.testing.assert_array_equal(one.lower, every.lower[place])
            np.testing.assert_array_equal(one.upper, every.upper[place])


def test_bad_intervals_are_refused() -> None:
    with pytest.raises(SetError, match="lower is greater than upper"):
        Interval(np.array(1.0), np.array(0.0))
    with pytest.raises(SetError, match="upper holds NaN"):
        Interval(np.array(1.0), np.array(np.nan))
    with pytest.raises(SetError, match=r"\(2,\).*\(3,\)"):
        Interval(np.zeros(2), np.zeros(3))
    with pytest.raises(SetError, match=r"matrix has shape \(3, 3\), expected"):
        Interval(np.zeros(2), np.ones(2)).linear_map(np.eye(3))
    with pytest.raises(SetError, match="have no product"):
        Interval(np.zeros(2), np.ones(2)) @ np.eye(2)
