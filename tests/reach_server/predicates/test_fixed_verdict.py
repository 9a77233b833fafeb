"""The compiled status of fixed strips against exact arithmetic."""

from fractions import Fraction

import numpy as np
import pytest

from reach_server.numeric.types import FloatArray
from reach_server.predicates.fixed_verdict import fixed_verdict
from reach_server.predicates.interface import HOLDS, MAY_HOLD, NEVER


def exact_range(normal: FloatArray, center: FloatArray, generators: FloatArray) -> tuple[Fraction, Fraction]:
    def form(vector: FloatArray) -> Fraction:
        return sum((Fraction(a) * Fraction(b) for a, b in zip(normal, vector, strict=True)), Fraction(0))

    middle, reach = form(center), sum((abs(form(g)) for g in generators.T), Fraction(0))
    return middle - reach, middle + reach


@pytest.mark.parametrize("scale", [1.0, 1e-12, 1e12])
def test_what_is_certain_is_so_in_exact_arithmetic(scale: float) -> None:
    rng = np.random.default_rng(5)
    seen = set()
    for _ in range(400):
        n, g = int(rng.integers(1, 5)), int(rng.integers(0, 6))
        normal, center = rng.standard_normal((1, n)), scale * rng.standard_normal((1, n))
        generators = scale * rng.standard_normal((1, n, g))
        low, high = exact_range(normal[0], center[0], generators[0])
        # Bounds on, just inside and just outside of what the form can come to.
        lower = np.array([float(low) + scale * rng.choice([-1e-3, -1e-17, 0.0, 1e-3, 3.0])])
        upper = np.array([max(float(high) + scale * rng.choice([1e-3, 0.0, 1e-17, -1e-3, -9.0]), lower[0])])
        (found,) = fixed_verdict(normal, lower, upper, lower, upper, center, generators).tolist()
        seen.add(found)
        if found == HOLDS:
            assert Fraction(lower[0]) <= low
            assert high <= Fraction(upper[0])
        if found == NEVER:
            assert low > Fraction(upper[0]) or high < Fraction(lower[0])
    assert seen == {HOLDS, MAY_HOLD, NEVER}


def test_a_point_on_the_border_is_in() -> None:
    center, nothing = np.array([[1.998, -0.5]]), np.zeros((1, 2, 0))
    normal, lower, upper = np.eye(2), np.array([-1.0, -0.5]), np.array([1.998, 3.0])
    assert fixed_verdict(normal, lower, upper, lower, upper, center, nothing).tolist() == [HOLDS]
    assert fixed_verdict(normal, lower, upper, lower, upper, center + 0.1, nothing).tolist() == [NEVER]


def test_all_strips_have_to_hold_and_one_missed_is_enough() -> None:
    center, generators = np.zeros((1, 2)), np.eye(2)[None] * 0.5
    normal = np.eye(2)
    wide, narrow, beyond = (-1.0, 1.0), (-0.1, 0.1), (2.0, 3.0)
    for first, second, wanted in (
        (wide, wide, HOLDS), (wide, narrow, MAY_HOLD), (wide, beyond, NEVER), (narrow, beyond, NEVER)
    ):  # fmt: skip
        lower, upper = np.array([first[0], second[0]]), np.array([first[1], second[1]])
        assert fixed_verdict(normal, lower, upper, lower, upper, center, generators).tolist() == [wanted]
