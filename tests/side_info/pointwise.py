"""What a scenario says of a sampled drive, one sample after the other and slowly: nothing of the runtime is used."""

from collections.abc import Mapping, Sequence
from functools import reduce
from typing import Any

import numpy as np
from numpy.typing import NDArray

from side_info.stl import expression as e
from side_info.stl import nnf as n
from side_info.stl.predicates import DiscPredicate, LinearPredicate, Predicate

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

_FUNCTIONS: dict[str, Any] = {
    "abs": np.abs,
    "sqrt": np.sqrt,
    "sin": np.sin,
    "cos": np.cos,
    "tan": np.tan,
    "norm": lambda *parts: np.sqrt(sum(part**2 for part in parts)),
    "sumsqr": lambda *parts: sum(part**2 for part in parts),
    "min": lambda *parts: reduce(np.minimum, parts),
    "max": lambda *parts: reduce(np.maximum, parts),
}


def value(expression: e.Expression, states: Mapping[str, Floats], lag: int) -> Any:
    """Value at each sample but the first ``lag``, where the last received sample is ``lag`` samples ago.

    ``states`` holds (K,) of each state, and of ``t``.
    """

    def now(name: str) -> Floats:
        return states[name][lag:]

    match expression:
        case e.Number(number):
            return number
        case e.Name(name):
            return now(name)
        case e.Time():
            return now("t")
        case e.Steps():
            return lag
        case e.Last(name):
            return states[name][: len(states["t"]) - lag]
        case e.Sum(parts):
            return sum(value(part, states, lag) for part in parts)
        case e.Product(parts):
            return reduce(np.multiply, (value(part, states, lag) for part in parts))
        case e.Negation(operand):
            return -value(operand, states, lag)
        case e.Reciprocal(operand):
            return 1 / value(operand, states, lag)
        case e.Power(base, exponent):
            return value(base, states, lag) ** value(exponent, states, lag)
        case e.Call(function, arguments):
            return _FUNCTIONS[function](*(value(argument, states, lag) for argument in arguments))
    raise TypeError(expression)


def margins(predicate: Predicate, states: Mapping[str, Floats], lag: int = 0) -> Floats:
    """By how much the predicate holds at each sample but the first ``lag`` (K - lag,); negative: it does not."""
    match predicate:
        case LinearPredicate(_, coefficients, lower, upper):
            total = sum(factor * states[name][lag:] for name, factor in coefficients.items())
            return np.asarray(np.minimum(total - lower, upper - total))
        case DiscPredicate(_, center, radius):
            squares = sum((states[name][lag:] - middle) ** 2 for name, middle in center.items())
            return np.asarray(radius - np.sqrt(squares))
    return np.broadcast_to(value(predicate.expression, states, lag), (len(states["t"]) - lag,))


def holds(
    formula: n.Normal, predicates: Sequence[Predicate], states: Mapping[str, Floats], step_ns: int, lag: int = 0
) -> Bools:
    """Whether the formula holds at each sample but the first ``lag`` (K - lag,).

    Windows are taken at the samples that lie in them; of those after the drive's end nothing is asked, and nothing is
    found there.
    """

    def satisfied(part: n.Normal) -> Bools:
        return holds(part, predicates, states, step_ns, lag)

    def windows(start_ns: int, end_ns: int, count: int) -> list[slice]:
        first, last = -(-start_ns // step_ns), end_ns // step_ns
        return [slice(k + first, k + last + 1) for k in range(count)]

    match formula:
        case n.Constant(truth):
            return np.full(len(states["t"]) - lag, truth)
        case n.Literal(index):
            return np.asarray(margins(predicates[index], states, lag) >= 0)
        case n.Conjunction(operands):
            return np.asarray(np.all([satisfied(operand) for operand in operands], axis=0))
        case n.Disjunction(operands):
            return np.asarray(np.any([satisfied(operand) for operand in operands], axis=0))
        case n.Globally(start_ns, end_ns, operand):
            inner = satisfied(operand)
            return np.array([inner[window].all() for window in windows(start_ns, end_ns, len(inner))])
        case n.Finally(start_ns, end_ns, operand):
            inner = satisfied(operand)
            return np.array([inner[window].any() for window in windows(start_ns, end_ns, len(inner))])
        case n.Until(start_ns, end_ns, left, right):
            before, witness = satisfied(left), satisfied(right)
            return np.array(
                [
                    any(witness[j] and before[k : j + 1].all() for j in range(window.start, window.stop))
                    for k, window in enumerate(windows(start_ns, min(end_ns, step_ns * len(witness)), len(witness)))
                    for window in [slice(window.start, min(window.stop, len(witness)))]
                ]
            )
    raise TypeError(formula)
