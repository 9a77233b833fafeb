"""Normal forms against direct evaluation of the text."""

import math
from dataclasses import replace

import pytest

from side_info import (
    DiscPredicate,
    LinearPredicate,
    NonlinearPredicate,
    ScenarioError,
)
from side_info.stl.connectives import size_of
from side_info.stl.nnf import Conjunction, Constant, Disjunction, Literal, Normal, reach_ns
from side_info.stl.normal_form import MAX_SIZE, literals_in
from tests.side_info.corpus import COMPARISONS
from tests.side_info.stl.normal_forms import INFINITY, normal, predicates


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
        ("x1 == 2", {"x1": 1.0}, 2.0, 2.0),
        ("1 <= x1 == x1 <= 2", {"x1": 1.0}, 1.0, 2.0),
        ("sqrt(4)*x1 <= min(3, 4, 8)", {"x1": 2.0}, -INFINITY, 3.0),
        ("sqrt(2)*x1 <= exp(1)", {"x1": math.sqrt(2)}, -INFINITY, math.e),
        ("hypot(3, 4)*x1 <= sumsqr(1, 2)", {"x1": 5.0}, -INFINITY, 5.0),
        ("x1 <= atan2(1, -1) + 2^0.5*0", {"x1": 1.0}, -INFINITY, math.atan2(1, -1)),
        ("0*sin(x2) + x1 <= 4", {"x1": 1.0}, -INFINITY, 4.0),
        ("max(x1) <= min(2)", {"x1": 1.0}, -INFINITY, 2.0),
        ("hypot(x1 - 1) <= 2", {"x1": 1.0}, -1.0, 3.0),
        ("abs(abs(x1)) <= 1", {"x1": 1.0}, -1.0, 1.0),
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
        "hypot(x1 - 0.307, x2 - 0.044) <= 1.429",
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


def test_alternatives_are_named_by_their_text_and_counted() -> None:
    form, found = normal("abs(x1) >= 1")
    assert form == Disjunction((Literal(0), Literal(1)))
    assert found == (
        LinearPredicate("abs(x1) >= 1#1", {"x1": 1.0}, 1.0, INFINITY),
        LinearPredicate("abs(x1) >= 1#2", {"x1": 1.0}, -INFINITY, -1.0),
    )


@pytest.mark.parametrize(
    ("text", "structure"),
    [
        ("min(x1, x2, x3) >= 0", "and(0, 1, 2)"),
        ("max(x1, x2, x3) >= 0", "or(0, 1, 2)"),
        ("1 - max(x1, x2) >= 0", "and(0, 1)"),
        ("min(x1, max(x2, x3)) >= 1", "and(0, or(1, 2))"),
        ("abs(x1) + abs(x2) <= 1", "and(0, 1, 2, 3)"),
        ("x2 >= abs(x1)", "and(0, 1)"),
        ("abs(x1) == 1", "and(0, or(1, 2))"),
        ("norm(x1, x2) <= 0", "and(0, 1)"),
        ("sumsqr(x1) >= 4", "or(0, 1)"),
        ("max(x1, x2)*x1 >= 1", "or(and(0, 1), and(2, 3))"),
        ("sin(abs(x1)) >= 0.5", "or(and(0, 1), and(2, 3))"),
        ("abs(x1*x2) <= 1", "and(0, 1)"),
        ("max(t, 2*k) >= last(x1)", "0"),
        ("x1 <= max(t, 2*k)", "0"),
        ("norm(x1 - last(x1), x2) <= 2*k", "and(0, 1)"),
        ("norm(x1 - last(x1), x2) >= 2*k", "or(0, 1)"),
        ("x1^2 + x2^2 <= 4", "0"),
        ("1 <= 2", "True"),
        ("2 <= 1", "False"),
        ("x1 - x1 <= 2", "True"),
        ("abs(x1) >= -1", "True"),
        ("norm(x1, x2) >= 0", "True"),
        ("x1^0 <= 1", "True"),
        ("2 <= 1 or x1 >= 0", "0"),
        ("1 <= 1 and x1 >= 0", "0"),
        ("G[0:1](1 <= 1)", "True"),
    ],
)
def test_structures(text: str, structure: str) -> None:
    assert shown(normal(text)[0]) == structure


def shown(form: Normal) -> str:
    match form:
        case Constant(truth):
            return str(truth)
        case Literal(number):
            return str(number)
        case Conjunction(operands) | Disjunction(operands):
            return f"{'and' if isinstance(form, Conjunction) else 'or'}({', '.join(map(shown, operands))})"
    raise TypeError(form)


def test_negations_are_closed_complements() -> None:
    assert normal("x1 <= 2", positive=False) == normal("not x1 <= 2")
    assert normal("not x1 <= 2")[1] == (LinearPredicate("not x1 <= 2", {"x1": 1.0}, 2.0, INFINITY),)
    form, (below, above) = normal("not 1 <= x1 <= 2")
    assert shown(form) == "or(0, 1)"
    assert (below, above) == (
        LinearPredicate("not 1 <= x1", {"x1": 1.0}, -INFINITY, 1.0),
        LinearPredicate("not x1 <= 2", {"x1": 1.0}, 2.0, INFINITY),
    )
    (outside,) = normal("not norm(x1, x2) <= 3")[1]
    assert isinstance(outside, NonlinearPredicate)
    assert (outside.name, str(outside.expression)) == ("not norm(x1, x2) <= 3", "sumsqr(x1, x2) - 9")
    (lower,) = normal("not x1*x2 <= 3")[1]
    assert isinstance(lower, NonlinearPredicate)
    assert str(lower.expression) == "-(3 - x1 * x2)"
    for text in ("1 <= 1", "2 <= 1"):
        assert normal(f"not {text}")[0] == Constant(not eval(text))


def test_the_norm_of_a_distance_becomes_smooth() -> None:
    form, (far, near) = normal("norm(x1 - last(x1), x2 - last(x2)) <= 0.5*k")
    assert shown(form) == "and(0, 1)"
    assert isinstance(far, NonlinearPredicate)
    assert isinstance(near, NonlinearPredicate)
    assert str(far.expression) == "0.5 * k"
    assert str(near.expression) == "(0.5 * k)^2 - sumsqr(x1 - last(x1), x2 - last(x2))"
    assert (far.states, near.states) == ((), ("x1", "x2"))


def test_what_is_said_twice_is_one_predicate() -> None:
    form, found = normal("(x1 <= 2 or x2 >= 0) and (2 >= x1 or x2 >= 0) and F[0:1](x1 <= 2 or x2 >= 0)")
    assert len(found) == 2
    assert sorted(set(literals_in(form))) == [0, 1]
    assert size_of(form) == 8


def test_long_names_are_shortened_and_told_apart() -> None:
    long = " + ".join(["x1"] * 30)
    _, found = normal(f"{long} <= 2 and {long} <= 3")
    assert [predicate.name[-2:] for predicate in found] == ["#1", "#2"]
    assert all(len(predicate.name) == 82 for predicate in found)


def test_formulas_that_come_to_too_much_are_refused() -> None:
    many = " and ".join(f"x1 <= {k}" for k in range(257))
    with pytest.raises(ScenarioError, match=r"test:1:\d+: more than 256 predicates"):
        normal(many)
    text = "x1 <= 1 until[0:1] x2 <= 1"
    for _ in range(9):
        text = f"({text}) until[0:1] ({text})" if len(text) < 9000 else text
    with pytest.raises(ScenarioError, match=f"comes to more than {MAX_SIZE} parts"):
        normal(f"not ({text})")


def test_negated_untils_may_be_nested() -> None:
    form, _ = normal("not (x1 <= 1 until[0:2] (x2 <= 1 until[0:3] x3 >= 1))")
    assert reach_ns(form) == 5 * 10**9


@pytest.mark.parametrize(("text", "column", "words"), COMPARISONS)
def test_refusals_name_the_place_and_the_reason(text: str, column: int, words: str) -> None:
    with pytest.raises(ScenarioError) as refused:
        normal(text)
    first = str(refused.value).split("\n")[0]
    assert first.startswith(f"test:1:{column}: "), first
    assert words in first
