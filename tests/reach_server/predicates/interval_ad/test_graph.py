"""Expressions as graphs: same value as an independent evaluation, and their domains."""

import casadi
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from reach_server.numeric.types import FloatArray
from reach_server.predicates.interval_ad.graph import Symbolic, symbolic
from side_info import ScenarioError
from side_info.stl.expression import (
    Call,
    Expression,
    Last,
    Name,
    Negation,
    Number,
    Power,
    Product,
    Reciprocal,
    Sum,
    Time,
)
from tests.examples import examples
from tests.reach_server.predicates.expressions import evaluate, random_expression

INDEX = {"a": 0, "b": 2, "c": 1}
A, B, C = Name("a"), Name("b"), Name("c")


def value(graph: Symbolic, x: FloatArray, last: FloatArray, t: float, k: float, last_t: float) -> float:
    function = casadi.Function("f", [graph.states, graph.constants, graph.context], [graph.value])
    times = {"t": t, "k": k, "last t": last_t}
    context = [last[g] if isinstance(g, int) else times[g] for g in graph.given]
    return float(function(x[list(graph.coordinates)], list(graph.numbers), context))


@settings(max_examples=examples(200))
@given(st.integers(0, 2**32 - 1))
def test_a_graph_has_the_value_of_its_expression(seed: int) -> None:
    rng = np.random.default_rng(seed)
    expression = random_expression(rng, tuple(INDEX), int(rng.integers(0, 5)))
    x, last = rng.normal(size=(2, 3))
    found = value(symbolic(expression, INDEX), x, last, 1.5, 2.0, 1.25)
    expected = evaluate(
        expression,
        {name: x[place] for name, place in INDEX.items()},
        {"t": np.array(1.25), **{name: last[place] for name, place in INDEX.items()}},
        np.array(1.5),
        np.array(2.0),
    )
    if np.isfinite(expected) and abs(expected) < 1e12:
        np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize(
    ("expression", "demands"),
    [
        (Reciprocal(A), ["nonzero"]),
        (Product((A, Reciprocal(B))), ["nonzero"]),
        (Call("sqrt", (A,)), ["nonnegative"]),
        (Call("log", (A,)), ["positive"]),
        (Call("tan", (A,)), ["nonzero"]),
        (Power(A, Number(0.5)), ["nonnegative"]),
        (Power(A, Number(1.5)), ["nonnegative"]),
        (Power(A, Negation(Number(1.5))), ["positive"]),
        (Power(A, Negation(Number(2.0))), ["nonzero"]),
        (Power(A, B), ["positive"]),
        (Power(A, Number(3.0)), []),
        (Call("norm", (A, B)), []),
        # CasADi simplifies these to `a`, to 0 and to 1, which are defined everywhere.
        (Power(Call("sqrt", (A,)), Number(2.0)), ["nonnegative"]),
        (Sum((Call("log", (A,)), Negation(Call("log", (A,))))), ["positive", "positive"]),
        (Product((A, Reciprocal(A))), ["nonzero"]),
    ],
)
def test_where_an_expression_is_defined(expression: Expression, demands: list[str]) -> None:
    assert [demand for _, demand in symbolic(expression, INDEX).domain] == demands


def test_numbers_stay_as_they_were_written() -> None:
    graph = symbolic(Sum((Number(0.1), Number(0.2), Negation(Number(0.1)), A)), INDEX)
    assert graph.numbers == (0.1, 0.2)
    assert graph.coordinates == (0,)


def test_two_names_of_one_state_are_one_symbol() -> None:
    graph = symbolic(Sum((A, Negation(B), Last("a"), Last("b"), Last("t"), Time())), {"a": 4, "b": 4})
    assert graph.coordinates == (4,)
    assert graph.given == (4, "last t", "t")


@pytest.mark.parametrize(
    ("expression", "message"),
    [
        (Name("d"), "'d' has no place"),
        (Last("d"), "'d' has no place"),
        (Call("gamma", (A,)), "gamma of 1"),
        (Call("sin", (A, B)), "sin of 2"),
    ],
)
def test_what_cannot_be_compiled(expression: Expression, message: str) -> None:
    with pytest.raises(ScenarioError, match=message):
        symbolic(expression, INDEX)
