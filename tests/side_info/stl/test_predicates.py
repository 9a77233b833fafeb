"""What is no strip, half-space or disc is refused when it is made."""

import math

import pytest

from side_info import DiscPredicate, LinearPredicate, ScenarioError


@pytest.mark.parametrize(
    ("coefficients", "lower", "upper"),
    [
        ({}, 0.0, 1.0),
        ({"x": 0.0}, 0.0, 1.0),
        ({"x": math.nan}, 0.0, 1.0),
        ({"x": math.inf}, 0.0, 1.0),
        ({"x": 1.0}, 1.0, 0.0),
        ({"x": 1.0}, math.nan, 0.0),
        ({"x": 1.0}, -math.inf, math.inf),
        ({"x": 1.0}, math.inf, math.inf),
    ],
)
def test_linear_predicates_that_mean_nothing(coefficients: dict[str, float], lower: float, upper: float) -> None:
    with pytest.raises(ScenarioError, match="name: "):
        LinearPredicate("name", coefficients, lower, upper)


@pytest.mark.parametrize(
    ("center", "radius"),
    [
        ({"x": 0.0}, 1.0),
        ({"x": 0.0, "y": 0.0, "z": 0.0}, 1.0),
        ({"x": math.nan, "y": 0.0}, 1.0),
        ({"x": 0.0, "y": 0.0}, 0.0),
        ({"x": 0.0, "y": 0.0}, -1.0),
        ({"x": 0.0, "y": 0.0}, math.inf),
        ({"x": 0.0, "y": 0.0}, math.nan),
    ],
)
def test_discs_that_mean_nothing(center: dict[str, float], radius: float) -> None:
    with pytest.raises(ScenarioError, match="name: "):
        DiscPredicate("name", center, radius)


def test_a_predicate_keeps_its_own_copy() -> None:
    coefficients = {"x": 1.0}
    predicate = LinearPredicate("name", coefficients, 0.0, 1.0)
    coefficients["y"] = 1.0
    assert predicate.states == ("x",)
