"""Durations in documents: a number of seconds, or text with one of the units ms, s, min."""

import math
import re
from typing import Final

_FACTORS: Final = {"": 1.0, "ms": 1e-3, "s": 1.0, "min": 60.0}
_TOO_LARGE: Final = 2.0**1023
_DURATION: Final = re.compile(r"\s*([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)\s*(ms|s|min)?\s*")


def seconds(value: object) -> float:
    """Seconds of ``25``, ``"25 s"``, ``"250 ms"`` or ``"2 min"``; raise ``ValueError`` for anything else."""
    if isinstance(value, int | float) and not isinstance(value, bool):
        # An integer may be too large for a float; it counts as infinite then.
        number, unit = float(value) if abs(value) < _TOO_LARGE else math.inf, ""
    elif isinstance(value, str) and (match := _DURATION.fullmatch(value)):
        number, unit = float(match[1]), match[2] or ""
    else:
        raise ValueError(f"{value!r:.60} is not a duration: write a number of seconds, or one with ms, s or min")
    result = number * _FACTORS[unit]
    if not math.isfinite(result):
        raise ValueError(f"{value!s:.60} is not a finite duration")
    return result
