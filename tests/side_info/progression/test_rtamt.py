"""The tableau against RTAMT, in its discrete and its dense time."""

import logging
import warnings
from random import Random
from typing import Any

import numpy as np
import pytest

from side_info.progression import Grid, Table
from side_info.stl.nnf import Conjunction, Constant, Disjunction, Finally, Globally, Literal, Normal, Until, reach_ns
from tests.side_info.progression.readings import Bools, accepts, random_formula

with warnings.catch_warnings():
    # Its parser's runtime imports from a module that Python is about to drop.
    warnings.simplefilter("ignore", DeprecationWarning)
    rtamt = pytest.importorskip("rtamt")

NAMES = ("a", "b")


def rtamt_text(formula: Normal, *, closed: bool) -> str:
    """A formula in RTAMT's words; ``closed``: its until asks the left of the witness, too."""

    def inner(operand: Normal) -> str:
        return rtamt_text(operand, closed=closed)

    match formula:
        case Constant(value):
            return "(a >= 0 or a <= 0)" if value else "(a >= 5)"
        case Literal(predicate):
            return f"({NAMES[predicate]} >= 0)"
        case Conjunction(operands):
            return "(" + " and ".join(map(inner, operands)) + ")"
        case Disjunction(operands):
            return "(" + " or ".join(map(inner, operands)) + ")"
        case Globally(start, end, operand):
            return f"(always[{start}:{end}] {inner(operand)})"
        case Finally(start, end, operand):
            return f"(eventually[{start}:{end}] {inner(operand)})"
        case Until(start, end, left, right):
            witness = inner(right) if closed else f"({inner(right)} and {inner(left)})"
            return f"({inner(left)} until[{start}:{end}] {witness})"
    raise TypeError(formula)


def parsed(kind: Any, text: str) -> Any:
    specification = kind()
    for name in NAMES:
        specification.declare_var(name, "float")
    logging.disable(logging.WARNING)  # it says that `out` was not declared
    specification.spec = f"out = {text}"
    specification.parse()
    logging.disable(logging.NOTSET)
    return specification


def test_discrete_time() -> None:
    """RTAMT's discrete until does not ask the left of the witness, so it is asked beside; bounds in samples."""
    rng, arrays = Random(1), np.random.default_rng(1)
    seen = {True: 0, False: 0}
    for _ in range(120):
        formula = random_formula(rng, 3, 2, lambda rng: (start := rng.randint(0, 2), start + rng.randint(0, 3)))
        specification = parsed(rtamt.StlDiscreteTimeSpecification, rtamt_text(formula, closed=False))
        table = Table(max_alternatives=10**6)
        root = table.add(formula, Grid(step_ns=1), lambda predicate, margin: predicate)
        # RTAMT cuts windows off where the trace ends, so it has to be as long as the formula reaches; it wants two.
        count = max(reach_ns(formula) + 1, 2)
        for _ in range(6):
            true = arrays.random((count, 2)) < arrays.choice([0.3, 0.6, 0.9])
            values = {name: np.where(true[:, i], 1.0, -1.0).tolist() for i, name in enumerate(NAMES)}
            robustness = specification.evaluate({"time": list(range(count)), **values})[0][1]
            assert accepts(table, root, true) == (robustness > 0), formula
            seen[bool(robustness > 0)] += 1
    assert min(seen.values()) > 100


def may_hold(breaks: list[float], true: Bools, stamp: float, margin: float) -> Bools:
    """(predicates,): whether a signal, constant from one break to the next, is true somewhere near a stamp."""
    ends = [*breaks[1:], np.inf]
    near = [start <= stamp + margin and end >= stamp - margin for start, end in zip(breaks, ends, strict=True)]
    held: Bools = np.array([column.any() for column in true[near].T], dtype=np.bool_)
    return held


@pytest.mark.slow
def test_dense_time() -> None:
    """Signals that switch at any time: where RTAMT's dense time says true, the samples allow it.

    What lies within a margin of motion of a sample is then what the signal is that much earlier or later.
    """
    rng, arrays = Random(2), np.random.default_rng(2)
    fulfilled = refuted = 0
    step = 10
    for _ in range(150):
        formula = random_formula(rng, 3, 2, lambda rng: (start := rng.randint(0, 20), start + rng.randint(1, 30)))
        specification = parsed(rtamt.StlDenseTimeSpecification, rtamt_text(formula, closed=True))
        margins: list[tuple[int, int]] = []

        def literal(predicate: int, margin: int, margins: list[tuple[int, int]] = margins) -> int:
            margins.append((predicate, margin))
            return len(margins) - 1

        table = Table(max_alternatives=10**6)
        root = table.add(formula, Grid(step, continuous=True), literal)
        count = reach_ns(formula) // step + 2
        for _ in range(6):
            # No switch falls on a bound of a window or a sample, where closed and open would differ.
            breaks = [0.0, *np.sort(arrays.uniform(0, count * step, arrays.integers(1, 3 * count))).tolist()]
            true = arrays.random((len(breaks), 2)) < arrays.choice([0.3, 0.6, 0.9])
            points: list[Any] = [
                [name, [[t, 1.0 if held else -1.0] for t, held in zip(breaks, true[:, i], strict=True)]]
                for i, name in enumerate(NAMES)
            ]
            end = count * step + 100.0
            for _, values in points:
                values.append([end, values[-1][1]])
            robustness = specification.evaluate(*points)[0][1]
            at = [
                [bool(may_hold(breaks, true, k * step, margin)[predicate]) for predicate, margin in margins]
                for k in range(count)
            ]
            accepted = accepts(table, root, np.array(at, dtype=bool).reshape(count, -1))
            assert accepted or robustness < 0, formula
            fulfilled += robustness > 0
            refuted += not accepted
    assert fulfilled > 200
    assert refuted > 100
