"""Whom a conflict is blamed on: predicates that do contradict each other, the same whatever their units."""

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import linprog

from reach_server.numeric.types import FloatArray
from reach_server.predicates import Context, Literals
from reach_server.predicates.infeasible_subset import conflicting
from reach_server.sets.raw import RawSets
from side_info import LinearPredicate
from tests.examples import examples, generator

pytestmark = pytest.mark.property

#: Normal and bounds of a strip.
Half = tuple[FloatArray, float, float]
INF = np.inf


def nothing(literal: int, rows: NDArray[np.intp]) -> Context:
    """Nothing that a linear predicate refers to."""
    zero = np.zeros(len(rows))
    return Context(zero, zero, zero, np.zeros((len(rows), 2)), np.zeros((len(rows), 2)))


def responsible(one: RawSets, halves: list[Half], scales: FloatArray) -> list[int]:
    """The predicates that are named, each multiplied by its scale."""
    literals = Literals(2, (0, 1), np.zeros((2, 0)))
    for i, ((normal, lower, upper), scale) in enumerate(zip(halves, scales.tolist(), strict=True)):
        coefficients = {f"x{j}": float(c) * scale for j, c in enumerate(normal) if c}
        predicate = LinearPredicate(f"p{i}", coefficients, lower * scale, upper * scale)
        assert literals.add(predicate, {"x0": 0, "x1": 1}, scenario="s", name=f"p{i}") == i
    return conflicting(one, 0, range(len(halves)), literals, nothing, 2)


def contradicts(one: RawSets, halves: list[Half]) -> bool:
    """Whether no state of the set satisfies all, by a linear program of its own over rows of like size."""
    rows, limits = [], []
    for normal, lower, upper in halves:
        heights, middle = normal @ one.generators[0, :2], float(normal @ one.center[0, :2])
        size = np.abs(heights).sum()
        for sign, bound in ((1.0, upper), (-1.0, -lower)):
            if np.isfinite(bound):
                rows.append(sign * heights / size)
                limits.append((bound - sign * middle) / size)
    found = linprog(np.zeros(len(rows[0])), A_ub=np.array(rows), b_ub=np.array(limits), bounds=(-1, 1))
    return bool(found.status == 2)


SQUARE = RawSets.zonotope(np.zeros((1, 2)), np.eye(2)[None])
RIGHT: Half = (np.array([1.0, 0.0]), 0.5, INF)
LEFT: Half = (np.array([1.0, 0.2]), -INF, 0.2)
FAR: Half = (np.array([1.0, 1.0]), -5.0, 5.0)


@pytest.mark.parametrize("scale", [1e-9, 1e-6, 1e-3, 1.0, 1e3, 1e6, 1e9])
@pytest.mark.parametrize("of", [(1, 1, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 1, 1), (1, -1, 0)])
def test_both_of_two_are_blamed_in_any_units(scale: float, of: tuple[int, int, int]) -> None:
    assert responsible(SQUARE, [RIGHT, LEFT, FAR], scale ** np.array(of, dtype=float)) == [0, 1]


def test_who_alone_leaves_nothing_is_blamed_alone() -> None:
    for scale in (1e-9, 1.0, 1e9):
        assert responsible(SQUARE, [RIGHT, (np.array([0.0, 1.0]), 1.5, 2.0)], np.array([1.0, scale])) == [1]


def test_nobody_is_blamed_where_something_is_left() -> None:
    for scale in (1e-9, 1.0, 1e9):
        assert responsible(SQUARE, [RIGHT, FAR], np.array([1.0, scale])) == []


@pytest.mark.slow
def test_blame_is_the_same_in_all_units_and_falls_on_those_that_contradict() -> None:
    rng = generator("conflicts")
    found = 0
    for _ in range(examples(150)):
        center, generators = rng.normal(size=2), rng.normal(size=(2, rng.integers(2, 6)))
        one = RawSets.zonotope(center[None], generators[None])
        halves: list[Half] = []
        for _ in range(rng.integers(2, 5)):
            normal = rng.normal(size=2) * rng.choice([0.01, 1.0, 100.0])
            reach = np.abs(normal @ generators).sum()
            low = float(normal @ center + rng.uniform(-0.2, 0.9) * reach)
            halves.append((normal, low, low + float(reach) if rng.random() < 0.3 else INF))
        usual = responsible(one, halves, np.ones(len(halves)))
        assert bool(usual) == contradicts(one, halves)
        assert not usual or contradicts(one, [halves[i] for i in usual])
        found += bool(usual)
        for scales in 10.0 ** rng.uniform(-9, 9, (4, len(halves))):
            assert responsible(one, halves, scales) == usual, (halves, scales)
    assert found > examples(150) / 10
