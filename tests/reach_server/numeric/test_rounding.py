"""Directed sums against exact fractions: no true sum lies beyond what comes back."""

from fractions import Fraction

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from reach_server.numeric.rounding import add_down, add_up, sum_up
from tests.reach_server.numeric.strategies import numbers
from tests.reach_server.ugly import moderate


@moderate
@given(numbers, numbers)
def test_directed_sums_are_next_to_the_exact_one(a: float, b: float) -> None:
    exact = Fraction(a) + Fraction(b)
    low, high = float(add_down(a, b)), float(add_up(a, b))
    assert low == -np.inf or Fraction(low) <= exact
    assert high == np.inf or Fraction(high) >= exact
    if np.isfinite([low, high]).all():
        assert Fraction(high) - Fraction(low) <= Fraction(float(np.spacing(1.0))) * max(abs(exact), Fraction(1e-300))
        assert (low == high) == (Fraction(a + b) == exact)


@moderate
@given(st.lists(st.floats(0, 1e300), min_size=1, max_size=20))
def test_sums_of_sizes_are_rounded_up(values: list[float]) -> None:
    total = float(sum_up(np.array(values)))
    exact = sum((Fraction(v) for v in values), Fraction(0))
    assert exact <= Fraction(total) <= exact * (1 + Fraction(len(values)) * Fraction(1, 2**50))
    assert float(sum_up(np.array(values[:1]))) == values[0]


def test_directed_sums_of_infinities_hold_what_they_may_stand_for() -> None:
    inf, most = np.inf, float(np.finfo(np.float64).max)
    for a, b, low, high in [
        (inf, 1.0, inf, inf), (-inf, -1.0, -inf, -inf), (inf, inf, inf, inf), (inf, -inf, -inf, inf),
        (-inf, inf, -inf, inf), (most, most, most, inf), (-most, -most, -inf, -most), (most, 1.0, most, inf),
        (-most, -1.0, -inf, -most),
    ]:  # fmt: skip
        assert (float(add_down(a, b)), float(add_up(a, b))) == (low, high), (a, b)
    # Beside others, each is what it is alone.
    np.testing.assert_array_equal(add_up([1.0, inf, 0.1], [2.0, -inf, 0.2]), [3.0, inf, add_up(0.1, 0.2)])
    assert np.isnan(add_up(np.nan, 1.0))
