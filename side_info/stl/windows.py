"""Windows of time of the temporal operators."""

from decimal import Decimal
from typing import Final

from lark import Token, Tree

from fleet_bus.errors import ScenarioError
from side_info.documents.source_location import Excerpt
from side_info.stl.arithmetic import read_number, undeclared
from side_info.stl.declarations import Declarations
from side_info.stl.expression import number_text
from side_info.stl.parser import Branch, start_of

#: Latest end of a window, seconds: nanoseconds since a scenario's time zero stay well inside 64 bits.
MAX_SECONDS: Final = 1e9

_FACTORS: Final = {"ms": Decimal("0.001"), "s": Decimal(1), "min": Decimal(60)}


def window_ns(start: float, end: float) -> tuple[int, int]:
    """First and last whole nanosecond of the window from ``start`` to ``end``, seconds in decimals.

    Exact where the bounds are whole nanoseconds, else rounded inwards: time is counted in whole nanoseconds, and the
    same of them lie in the window.
    """
    # Twelve digits are far below a nanosecond and above what is lost when 9 ms become seconds.
    first, last = (round(Decimal(repr(bound)), 12).scaleb(9) for bound in (start, end))
    return int(first.to_integral_value("ROUND_CEILING")), int(last.to_integral_value("ROUND_FLOOR"))


def check_window(start: float, end: float) -> None:
    """Raise ``ScenarioError`` if ``start`` to ``end`` (seconds from now) is no window that a formula may have."""
    for bound in (start, end):
        if not 0 <= bound <= MAX_SECONDS:
            raise ScenarioError(f"a bound of {bound:g} s: expected 0 to {MAX_SECONDS:g} s")
    if start > end:
        raise ScenarioError(f"the window is reversed: {number_text(start)} s > {number_text(end)} s")
    first, last = window_ns(start, end)
    if first > last:
        raise ScenarioError("the window holds no whole nanosecond")


def read_window(window: Tree[Token], excerpt: Excerpt, declared: Declarations) -> tuple[float, float]:
    """Bounds in seconds; raise ``ScenarioError`` at what is no bound, or at the window if they make none."""
    start, end = (_bound(child, excerpt, declared) for child in window.children)
    try:
        check_window(start, end)
    except ScenarioError as error:
        raise excerpt.error(start_of(window), str(error)) from None
    return start, end


def _bound(branch: Branch, excerpt: Excerpt, declared: Declarations) -> float:
    assert not isinstance(branch, Token)
    at = start_of(branch)
    value, *unit = (child for child in branch.children if isinstance(child, Token))
    if branch.data == "negative_bound":
        raise excerpt.error(at, "a bound is negative: expected seconds from now on, 0 or later")
    if value.type == "NUMBER":
        # In decimals, so that 9 ms are the same number as 0.009 s.
        read_number(value, excerpt)
        seconds = float(Decimal(value) * _FACTORS[unit[0] if unit else "s"])
    elif value in declared.parameters:
        seconds = declared.parameters[value]
    elif value in declared.states or value in declared.regions or value in ("t", "k"):
        raise excerpt.error(at, f"a bound is a number or a parameter, {str(value)!r} is neither")
    else:
        raise undeclared(value, excerpt, declared)
    if not 0 <= seconds <= MAX_SECONDS:
        raise excerpt.error(at, f"a bound of {seconds:g} s: expected 0 to {MAX_SECONDS:g} s")
    return seconds
