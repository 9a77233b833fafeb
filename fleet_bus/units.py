"""Durations in documents (a number of seconds, or text with one of the units ms, s, min), and units as people write
them: what is the same unit, and how large it is."""

import math
import re
from typing import Final

_FACTORS: Final = {"": 1.0, "ms": 1e-3, "s": 1.0, "min": 60.0}
_TOO_LARGE: Final = 2.0**1023
_DURATION: Final = re.compile(r"\s*([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)\s*(ms|s|min)?\s*")


#: Other ways to write a name that occurs in a unit.
_NAMES: Final = {
    name: short
    for short, names in {
        "m": ("meter", "meters", "metre", "metres"), "mm": ("millimeter", "millimeters", "millimetre", "millimetres"),
        "cm": ("centimeter", "centimeters", "centimetre", "centimetres"),
        "km": ("kilometer", "kilometers", "kilometre", "kilometres"),
        "s": ("sec", "secs", "second", "seconds"), "ms": ("msec", "millisecond", "milliseconds"),
        "h": ("hr", "hour", "hours"), "rad": ("radian", "radians", "rads"), "deg": ("degree", "degrees", "°"),
        "1": ("-", "none", "unitless", "dimensionless", "ratio"),
    }.items()
    for name in names
}  # fmt: skip
_WHOLE: Final = {"mps": "m/s", "kmh": "km/h", "kph": "km/h", "kmph": "km/h", "rps": "rad/s", "": "1"}
_RAISED: Final = str.maketrans("⁰¹²³⁴⁵⁶⁷⁸⁹⁻", "0123456789-")
_FACTOR: Final = re.compile(r"([^\W\d_]+|°|%|-|1)(?:\^|\*\*)?([+-]?\d{1,2})?")
_SIZES: Final = {
    "m": 1.0, "mm": 1e-3, "cm": 1e-2, "km": 1e3, "s": 1.0, "ms": 1e-3, "min": 60.0, "h": 3600.0, "rad": 1.0,
    "deg": math.pi / 180, "1": 1.0,
}  # fmt: skip


def canonical(unit: str) -> str:
    """One spelling of a unit, such as ``m/s^2`` for ``m/s2``, ``m/s²``, ``m/s**2``, ``m s^-2`` and ``meters/sec^2``.

    A text that is no product of powers comes back as it is, stripped: it equals itself only. Capitals count, as in mm
    and Mm, but for words of more than two letters.
    """
    powers = _powers(unit)
    if powers is None:
        return unit.strip()
    parts = [[_power(n, abs(p)) for n, p in sorted(powers.items()) if sign * p > 0] for sign in (1, -1)]
    return "/".join((" ".join(parts[0]) or "1", *parts[1]))


def size(unit: str) -> float | None:
    """How many of m, s and rad (products of their powers) one of the unit is; None for a unit that is not known."""
    powers = _powers(unit)
    if powers is None or not powers.keys() <= _SIZES.keys():
        return None
    return math.prod(_SIZES[name] ** power for name, power in powers.items())


def _powers(unit: str) -> dict[str, int] | None:
    """Name to power of a unit."""
    text = unit.strip().translate(_RAISED)
    text = _WHOLE.get(text.lower(), text)
    found: dict[str, int] = {}
    over, *under = re.split(r"\s*/\s*", text)
    for sign, group in ((1, over), *((-1, part) for part in under)):
        for factor in re.split(r"[\s·⋅]+|(?<!\*)\*(?!\*)", group.strip("() ")):
            match = _FACTOR.fullmatch(factor)
            if match is None:
                return None
            name = match[1].lower() if len(match[1]) > 2 else match[1]
            name = _NAMES.get(name, name)
            if name != "1":
                found[name] = found.get(name, 0) + sign * int(match[2] or 1)
    return found


def _power(name: str, power: int) -> str:
    return name if power == 1 else f"{name}^{power}"


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
