"""A slow, independent meaning of the language: Python's own, which shares its precedence and chains."""

import math
from collections.abc import Mapping

from side_info import DiscPredicate, LinearPredicate, Predicate


def holds(text: str, state: Mapping[str, float]) -> bool:
    """Whether a comparison or conjunction of them holds at a state."""
    functions = {
        "abs": abs,
        "norm": math.hypot,
        "sumsqr": lambda *parts: math.fsum(part * part for part in parts),
    }
    return bool(eval(text.replace("^", "**"), {"__builtins__": {}, **functions}, dict(state)))


def margin(predicate: Predicate, state: Mapping[str, float]) -> float:
    """How far inside of its set a predicate is (negative: outside), in its own measure."""
    if isinstance(predicate, DiscPredicate):
        return predicate.radius - math.hypot(*(state[name] - at for name, at in predicate.center.items()))
    assert isinstance(predicate, LinearPredicate)
    value = math.fsum(c * state[name] for name, c in predicate.coefficients.items())
    return min(value - predicate.lower, predicate.upper - value)
