"""Normal forms against direct evaluation of the text."""

import math
import random
from contextlib import suppress
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from side_info import (
    Declarations,
    DiscPredicate,
    Formula,
    LinearPredicate,
    NonlinearPredicate,
    Predicate,
    ScenarioError,
)
from side_info.documents.source_location import Excerpt
from side_info.stl.connectives import size_of
from side_info.stl.expression import Call, names_of, nodes_of
from side_info.stl.nnf import Conjunction, Constant, Disjunction, Literal, Normal, reach_ns
from side_info.stl.normal_form import MAX_SIZE, NormalForms, literals_in
from tests.side_info.corpus import COMPARISONS
from tests.side_info.evaluator import accepts, holds, margin

INFINITY = math.inf
DECLARED = Declarations(("x1", "x2", "x3"), (), {"c": 0.307})


def normal(text: str, *, positive: bool = True) -> tuple[Normal, tuple[Predicate, ...]]:
    forms = NormalForms()
    formula = Formula.parse(text, DECLARED, "test")
    return forms.of(formula, Excerpt.alone(text, "test"), holds=positive), forms.predicates()


def predicates(text: str) -> tuple[Predicate, ...]:
    """Predicates of a comparison that is a conjunction of them."""
    form, found = normal(text)
    expected = tuple(map(Literal, range(len(found))))
    assert form == (Conjunction(expected) if len(found) > 1 else expected[0])
    return found


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
@pytest.mark.slow
def test_predicates_agree_with_the_text(
    template: str, a: str, b: str, c: str, d: str, p: str, q: str, seed: int
) -> None:
    text = template.format(a=a, b=b, c=c, d=d, p=p, q=q)
    try:
        form, found = normal(text)
    except ScenarioError:
        # The coefficients happened to cancel.
        return
    formula = Formula.parse(text, DECLARED)
    chance = random.Random(seed)
    for _ in range(40):
        state = {"x1": chance.uniform(-8, 8), "x2": chance.uniform(-8, 8)}
        if all(abs(margin(predicate, state)) > 1e-9 for predicate in found):
            assert holds(formula, [state]) == accepts(form, found, [state], 0.0), (text, state)


def test_no_predicate_has_a_kink_in_a_state() -> None:
    for seed in range(200):
        with suppress(ScenarioError):
            _, found = normal(Texts(seed).comparison(3))
            for predicate in found:
                nodes = nodes_of(predicate.expression) if isinstance(predicate, NonlinearPredicate) else ()
                kinks = [node for node in nodes if isinstance(node, Call) and node.function in ("abs", "min", "max")]
                assert not any(map(names_of, kinks))


class Texts:
    """Random formulas with kinks, as text; windows are multiples of ``unit`` seconds."""

    def __init__(self, seed: int, unit: float = 1.0) -> None:
        self.chance = random.Random(seed)
        self.unit = unit

    def number(self) -> str:
        return f"{self.chance.randint(-30, 30) / 10}"

    def expression(self, depth: int) -> str:
        kind = self.chance.randrange(14) if depth else self.chance.randrange(4)
        if kind < 3:
            return self.chance.choice(["x1", "x2", "x1", "x2", "t", "k", "last(x1)"])
        if kind == 3:
            return f"({self.number()})"
        one, other = self.expression(depth - 1), self.expression(depth - 1)
        several = [f"({one}) + ({other})", f"({one}) - ({other})", f"({self.number()})*({one})"]
        kinked = [f"min({one}, {other})", f"max({one}, {other})", f"abs({one})", f"max({one}, {other}, 1, t)"]
        curved = [f"norm({one}, {other})", f"sumsqr({one}, {other})", f"sin({one})", f"({one})*({other})"]
        partial = [f"sqrt({one})", f"1/({one})", f"log({one})", f"({one})^2"]
        return self.chance.choice([*several, *several, *kinked, *kinked, *curved, *partial])

    def comparison(self, depth: int) -> str:
        left, right = self.expression(depth), self.number()
        if self.chance.random() < 0.2:
            return f"{right} <= {left} <= {self.number()}"
        return f"{left} {self.chance.choice(['<=', '>=', '<', '>', '==', '<='])} {right}"

    def formula(self, depth: int, kinks: int = 1) -> str:
        kind = self.chance.randrange(9) if depth else 0
        if kind < 2:
            return f"({self.comparison(kinks)})"
        one, other = self.formula(depth - 1, kinks), self.formula(depth - 1, kinks)
        start = self.chance.randint(0, 2) * self.unit
        window = f"[{start}:{start + self.chance.randint(0, 3) * self.unit}]"
        return self.chance.choice(
            [
                f"(not {one})", f"({one} and {other})", f"({one} or {other})", f"({one} -> {other})",
                f"G{window}{one}", f"F{window}{one}", f"({one} U{window} {other})",
            ]
        )  # fmt: skip

    def trace(self, length: int) -> list[dict[str, float]]:
        start = {name: self.chance.uniform(-3, 3) for name in ("x1", "x2")}
        return [
            {name: self.chance.uniform(-3, 3) for name in start}
            | {"t": float(k), "k": float(k)}
            | {f"last {name}": at for name, at in start.items()}
            for k in range(length)
        ]


def agreement(text: str, traces: list[list[dict[str, float]]]) -> tuple[int, int]:
    """How often a formula and its normal form were compared, and how often they were equal; implied in any case."""
    try:
        form, found = normal(text)
        fails, _ = normal(text, positive=False)
    except ScenarioError:
        # It can never hold, comes to too much, or has the logarithm of a negative number.
        return 0, 0
    formula = Formula.parse(text, DECLARED)
    _, found_too = normal(text, positive=False)
    compared = equal = 0
    for trace in traces:
        margins = [margin(predicate, state) for predicate in (*found, *found_too) for state in trace]
        if any(math.isnan(value) for value in margins):
            continue
        truth = holds(formula, trace)
        assert accepts(form if truth else fails, found if truth else found_too, trace, 1e-9), (text, trace)
        if all(abs(value) > 1e-9 for value in margins):
            compared += 1
            equal += accepts(form, found, trace, 0.0) == truth
            equal += accepts(fails, found_too, trace, 0.0) == (not truth)
    return compared, equal


@pytest.mark.slow
def test_kinks_and_connectives_at_one_time() -> None:
    compared = 0
    for seed in range(500):
        texts = Texts(seed)
        text = texts.comparison(3) if seed % 2 else texts.formula(2, kinks=2)
        count, equal = agreement(text, [texts.trace(22) for _ in range(6)])
        assert equal == 2 * count, text
        compared += count
    assert compared > 1000


@pytest.mark.slow
def test_formulas_over_time_on_the_grid() -> None:
    compared = 0
    for seed in range(400):
        texts = Texts(seed)
        count, equal = agreement(texts.formula(4, kinks=1), [texts.trace(22) for _ in range(6)])
        assert equal == 2 * count
        compared += count
    assert compared > 1000


@pytest.mark.slow
def test_formulas_over_time_off_the_grid_are_implied() -> None:
    compared = sum(
        agreement(texts.formula(4, kinks=0), [texts.trace(22) for _ in range(6)])[0]
        for texts in (Texts(seed, unit=0.7) for seed in range(400))
    )
    assert compared > 1000
