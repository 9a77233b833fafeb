"""Normal forms against direct evaluation of the text."""

import math
import random
from dataclasses import replace

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from side_info import (
    Comparison,
    Declarations,
    DiscPredicate,
    Formula,
    LinearPredicate,
    Predicate,
    ScenarioError,
)
from side_info.normal_form import normal_form
from side_info.places import Excerpt
from tests.side_info.corpus import COMPARISONS
from tests.side_info.evaluator import holds, margin

INFINITY = math.inf


def predicates(text: str) -> tuple[Predicate, ...]:
    formula = Formula.parse(text, Declarations(("x1", "x2", "x3"), (), {"c": 0.307}), "test")
    assert isinstance(formula, Comparison)
    return normal_form(formula, Excerpt.alone(text, "test"))


@pytest.mark.parametrize(
    ("text", "coefficients", "lower", "upper"),
    [
        ("x1 <= 2", {"x1": 1.0}, -INFINITY, 2.0),
        ("x1 < 2", {"x1": 1.0}, -INFINITY, 2.0),
        ("2 > x1", {"x1": 1.0}, -INFINITY, 2.0),
        ("-x1 <= 2", {"x1": 1.0}, -2.0, INFINITY),
        ("x1 - x2 >= 1 - 2*x1", {"x1": 3.0, "x2": -1.0}, 1.0, INFINITY),
        ("x2 >= x1", {"x1": 1.0, "x2": -1.0}, -INFINITY, 0.0),
        ("-1.437 <= x1 <= 1.998", {"x1": 1.0}, -1.437, 1.998),
        ("1 >= x1 - x2 > -1", {"x1": 1.0, "x2": -1.0}, -1.0, 1.0),
        ("x1 <= x2 <= x1 + 3", {"x1": 1.0, "x2": -1.0}, -3.0, 0.0),
        ("0 <= x1 <= 2 <= 3 + x1", {"x1": 1.0}, 0.0, 2.0),
        ("1 <= x1 <= 1", {"x1": 1.0}, 1.0, 1.0),
        ("1 - abs(x2 + 1.665) >= 0", {"x2": 1.0}, -2.665, -0.665),
        ("abs(x2 - 2.25) <= 1", {"x2": 1.0}, 1.25, 3.25),
        ("2*abs(1 - x1)/4 + 1 <= 2", {"x1": 1.0}, -1.0, 3.0),
        ("abs(x1 - 2*x2) <= 0", {"x1": 1.0, "x2": -2.0}, 0.0, 0.0),
        ("norm(2*x1 - 1) <= 3", {"x1": 2.0}, -2.0, 4.0),
        ("sumsqr(x1 - 1) <= 9", {"x1": 1.0}, -2.0, 4.0),
        ("0.1*x1 + 0.2*x1 <= 0.3", {"x1": 0.3}, -INFINITY, 0.3),
        ("x1/3*3 <= 2^-1", {"x1": 1.0}, -INFINITY, 0.5),
        ("(x1 + 1)^1 <= 2^2^2", {"x1": 1.0}, -INFINITY, 15.0),
        ("abs(-3)*x1 <= 6", {"x1": 3.0}, -INFINITY, 6.0),
    ],
)
def test_linear_forms(text: str, coefficients: dict[str, float], lower: float, upper: float) -> None:
    (found,) = predicates(text)
    assert replace(found, name="p") == LinearPredicate("p", coefficients, lower, upper)


@pytest.mark.parametrize(
    "text",
    [
        "norm(x1 - 0.307, x2 - 0.044) <= 1.429",
        "1.429 - norm(x1 - c, x2 - 0.044) >= 0",
        "sumsqr(x1 - 0.307, x2 - 0.044) <= 1.429^2",
        "sumsqr(0.307 - x1, x2 - 0.044) < 1.429*1.429",
        "0 <= 2.858 - norm(2*(x1 - 0.307), 2*x2 - 0.088)",
        "4*1.429**2 >= sumsqr(2*x1 - 0.614, 0.088 - 2*x2)",
    ],
)
def test_disc_forms(text: str) -> None:
    (found,) = predicates(text)
    assert replace(found, name="p") == DiscPredicate("p", {"x1": 0.307, "x2": 0.044}, 1.429)


def test_an_irrational_radius_is_the_nearest_double() -> None:
    for square in ("2", "1e-300", "3e300", "0.7"):
        (disc,) = predicates(f"sumsqr(x1, x2) <= {square}")
        assert isinstance(disc, DiscPredicate)
        assert disc.radius == pytest.approx(math.sqrt(float(square)), rel=2**-52)


def test_a_chain_that_is_no_strip_is_several_predicates_named_by_their_text() -> None:
    assert predicates("0 <= x1 <= x2 < 5") == (
        LinearPredicate("0 <= x1", {"x1": 1.0}, 0.0, INFINITY),
        LinearPredicate("x1 <= x2", {"x1": 1.0, "x2": -1.0}, -INFINITY, 0.0),
        LinearPredicate("x2 < 5", {"x2": 1.0}, -INFINITY, 5.0),
    )


@pytest.mark.parametrize(("text", "column", "words"), COMPARISONS)
def test_refusals_name_the_place_and_the_reason(text: str, column: int, words: str) -> None:
    with pytest.raises(ScenarioError) as refused:
        predicates(text)
    first = str(refused.value).split("\n")[0]
    assert first.startswith(f"test:1:{column}: "), first
    assert words in first


decimals = st.integers(-4000, 4000).map(lambda thousandths: f"{thousandths / 1000}")
positive = st.integers(1, 4000).map(lambda thousandths: f"{thousandths / 1000}")
TEMPLATES = [
    "{a}*x1 + {b}*x2 - {c} <= {d}*x1 + 7.5",
    "{a} - ({b} + x1)/{p} > x2*{q}",
    "{q} - abs({a}*x1 - {p}*x2 + {c}) >= 0",
    "{a} - {p} <= {b}*x1 + {q}*x2 < {a} + {q}",
    "abs({p}*(x1 - {a}) - (x2 - {b})*-2) <= {q}",
    "norm(x1 - {a}, x2 - {b}) <= {p}",
    "{p} - norm({q}*(x2 - {a}), {q}*x1) >= 0",
    "sumsqr(x1 + {a}, {b} - x2) < {p}^2",
    "-{p}*sumsqr(x1, x2 - {a}) >= -{q}",
    "x1 - {p} <= x2 <= x1 + {q} <= {p} + 9",
]


@given(st.sampled_from(TEMPLATES), decimals, decimals, decimals, decimals, positive, positive, st.integers())
def test_predicates_agree_with_the_text(
    template: str, a: str, b: str, c: str, d: str, p: str, q: str, seed: int
) -> None:
    text = template.format(a=a, b=b, c=c, d=d, p=p, q=q)
    try:
        found = predicates(text)
    except ScenarioError:
        # The coefficients happened to cancel.
        assume(False)
    chance = random.Random(seed)
    for _ in range(40):
        state = {"x1": chance.uniform(-8, 8), "x2": chance.uniform(-8, 8)}
        inside = min(margin(predicate, state) for predicate in found)
        if abs(inside) > 1e-9:
            assert holds(text, state) == (inside > 0), (text, state)
