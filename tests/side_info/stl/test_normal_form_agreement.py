"""Normal forms agree with what their texts say, at one time and over time."""

import math
import random
from contextlib import suppress

import pytest
from hypothesis import given
from hypothesis import strategies as st

from side_info import (
    Formula,
    NonlinearPredicate,
    ScenarioError,
)
from side_info.stl.expression import Call, names_of, nodes_of
from tests.side_info.evaluator import accepts, holds, margin
from tests.side_info.stl.normal_forms import DECLARED, normal

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
