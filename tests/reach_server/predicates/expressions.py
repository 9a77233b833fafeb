"""Random expressions of the scenario language, and what they come to at points: an oracle that shares no code with the
server."""

from collections.abc import Callable, Mapping
from functools import reduce

import numpy as np

from reach_server.numeric.types import FloatArray
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
    Steps,
    Sum,
    Time,
)

_FUNCTIONS: Mapping[str, Callable[..., FloatArray]] = {
    "abs": np.abs, "sqrt": np.sqrt, "exp": np.exp, "log": np.log, "sin": np.sin, "cos": np.cos, "tan": np.tan,
    # The real zero has no sign.
    "atan2": lambda y, x: np.arctan2(y + 0.0, x + 0.0),
    "min": lambda *a: reduce(np.minimum, a), "max": lambda *a: reduce(np.maximum, a),
    "sumsqr": lambda *a: sum(v**2 for v in a),
    "norm": lambda *a: np.sqrt(sum(v**2 for v in a)), "hypot": lambda *a: np.sqrt(sum(v**2 for v in a)),
}  # fmt: skip


def evaluate(
    expression: Expression,
    states: Mapping[str, FloatArray],
    last: Mapping[str, FloatArray],
    t: FloatArray,
    k: FloatArray,
) -> FloatArray:
    """Values at points; NaN or infinite where the expression is not defined."""

    def of(part: Expression) -> FloatArray:
        match part:
            case Number(value):
                return np.asarray(value)
            case Name(name):
                return states[name]
            case Last(name):
                return last[name]
            case Time():
                return t
            case Steps():
                return k
            case Sum(terms):
                return reduce(np.add, map(of, terms))
            case Product(factors):
                return reduce(np.multiply, map(of, factors))
            case Negation(operand):
                return -of(operand)
            case Reciprocal(operand):
                return 1 / of(operand)
            case Power(base, exponent):
                return np.power(of(base), of(exponent))
            case Call(function, arguments):
                return _FUNCTIONS[function](*map(of, arguments))
        raise TypeError(type(part).__name__)

    with np.errstate(all="ignore"):
        return np.asarray(of(expression), dtype=np.float64)


def number(value: float) -> Expression:
    """A number of either sign."""
    return Negation(Number(-value)) if value < 0 else Number(value)


def random_expression(rng: np.random.Generator, names: tuple[str, ...], depth: int = 3) -> Expression:
    """An expression in some of the states, with time, steps ahead and the last state in places; no kink in a state."""

    def leaf(*, given: bool) -> Expression:
        kinds = [Name(str(rng.choice(names))), number(round(float(rng.normal()), 2))]
        if given:
            kinds += [Time(), Steps(), Last(str(rng.choice(names))), Last("t")]
        return kinds[rng.choice(len(kinds), p=[0.6, 0.4] if not given else [0.5, 0.2, 0.08, 0.02, 0.15, 0.05])]

    def grown(left: int) -> Expression:
        if not left or rng.random() < 0.1:
            return leaf(given=True)
        kind = rng.integers(0, 12)
        if kind <= 2:
            return Sum((grown(left - 1), grown(left - 1)))
        if kind == 3:
            return Sum((grown(left - 1), Negation(grown(left - 1))))
        if kind <= 5:
            return Product((grown(left - 1), grown(left - 1)))
        if kind == 6:
            return Product((grown(left - 1), Reciprocal(grown(left - 1))))
        if kind == 7:
            return Power(grown(left - 1), Number(float(rng.choice([2, 2, 3, 4, 0.5, 1.5]))))
        if kind == 8:
            return Call(str(rng.choice(["sumsqr", "norm", "hypot"])), (grown(left - 1), grown(left - 1)))
        if kind == 9:
            return Call("atan2", (grown(left - 1), grown(left - 1)))
        if kind == 10:
            inner = Sum((Last(str(rng.choice(names))), Negation(Time())))
            return Product((grown(left - 1), Call("abs", (inner,))))
        return Call(str(rng.choice(["sin", "cos", "exp", "sqrt", "log", "tan", "sin", "cos"])), (grown(left - 1),))

    return grown(depth)
