"""A slow, independent meaning of the language: formulas by their definitions, and what they come to."""

import math
import re
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from types import CodeType
from typing import Any, Final

from side_info import (
    Always,
    And,
    Comparison,
    DiscPredicate,
    Eventually,
    Formula,
    Implies,
    LinearPredicate,
    Not,
    Or,
    Predicate,
    Until,
)
from side_info.stl.nnf import Conjunction, Constant, Disjunction, Finally, Globally, Literal, Normal
from side_info.stl.nnf import Until as NormalUntil

State = Mapping[str, float]

FUNCTIONS: Final[dict[str, Callable[..., Any]]] = {
    "abs": abs, "sqrt": math.sqrt, "exp": math.exp, "log": math.log, "sin": math.sin, "cos": math.cos, "tan": math.tan,
    "atan2": math.atan2, "norm": math.hypot, "hypot": math.hypot,
    "min": lambda *parts: min(parts), "max": lambda *parts: max(parts),
    "sumsqr": lambda *parts: math.fsum(part * part for part in parts),
}  # fmt: skip


_NAMES: Final = {"__builtins__": {}, **FUNCTIONS}


@cache
def _compiled(text: str) -> CodeType:
    return compile(re.sub(r"last\((\w+)\)", r"last('\1')", text).replace("^", "**"), "formula", "eval")


def value(text: str, state: State) -> Any:
    """Python's own meaning of an expression or comparison, which shares precedence and chains.

    NaN where it has no value. ``state`` also has ``t`` and ``k``, and the last value of ``x`` under ``last x``.
    """
    try:
        found = eval(_compiled(text), _NAMES | {"last": lambda name: state[f"last {name}"]}, dict(state))
    except (ValueError, ZeroDivisionError, OverflowError):
        return math.nan
    return math.nan if isinstance(found, complex) else found


def holds(formula: Formula, trace: Sequence[State], now: int = 0) -> bool:
    """Whether a formula holds at a sample of a trace with one sample every second, by the definitions."""

    def samples(start: float, end: float) -> range:
        last = now + math.floor(end)
        assert last < len(trace)
        return range(now + math.ceil(start), last + 1)

    match formula:
        case Not(operand):
            return not holds(operand, trace, now)
        case And(operands):
            return all(holds(operand, trace, now) for operand in operands)
        case Or(operands):
            return any(holds(operand, trace, now) for operand in operands)
        case Implies(left, right):
            return not holds(left, trace, now) or holds(right, trace, now)
        case Always(start, end, operand):
            return all(holds(operand, trace, then) for then in samples(start, end))
        case Eventually(start, end, operand):
            return any(holds(operand, trace, then) for then in samples(start, end))
        case Until(start, end, left, right):
            return any(
                holds(right, trace, then) and all(holds(left, trace, before) for before in range(now, then + 1))
                for then in samples(start, end)
            )
        case Comparison():
            return bool(value(str(formula), trace[now]))
    raise TypeError(formula)


def accepts(
    formula: Normal, predicates: Sequence[Predicate], trace: Sequence[State], slack: float, now: int = 0
) -> bool:
    """Whether a normal form holds at a sample, predicates being true from a margin of ``-slack`` on."""

    def samples(start_ns: int, end_ns: int) -> range:
        return range(now - (-start_ns // 10**9), now + end_ns // 10**9 + 1)

    def at(operand: Normal, then: int) -> bool:
        return accepts(operand, predicates, trace, slack, then)

    match formula:
        case Constant(truth):
            return truth
        case Literal(number):
            return not margin(predicates[number], trace[now]) < -slack
        case Conjunction(operands):
            return all(at(operand, now) for operand in operands)
        case Disjunction(operands):
            return any(at(operand, now) for operand in operands)
        case Globally(start, end, operand):
            return all(at(operand, then) for then in samples(start, end))
        case Finally(start, end, operand):
            return any(at(operand, then) for then in samples(start, end))
        case NormalUntil(start, end, left, right):
            return any(
                at(right, then) and all(at(left, before) for before in range(now, then + 1))
                for then in samples(start, end)
            )
    raise TypeError(formula)


def margin(predicate: Predicate, state: State) -> float:
    """How far inside of its set a predicate is (negative: outside), in its own measure; NaN where it says nothing."""
    if isinstance(predicate, DiscPredicate):
        return predicate.radius - math.hypot(*(state[name] - at for name, at in predicate.center.items()))
    if isinstance(predicate, LinearPredicate):
        total = math.fsum(c * state[name] for name, c in predicate.coefficients.items())
        return min(total - predicate.lower, predicate.upper - total)
    return float(value(str(predicate.expression), state))
