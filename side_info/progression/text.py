"""Obligations as text for people: windows in steps from now."""

from collections.abc import Callable

from side_info.progression.nodes import All, Always, Eventually, Later, Now, Some, Truth, Until
from side_info.progression.obligations import Obligations


def obligation_text(build: Obligations, obligation: int, name: Callable[[int], str]) -> str:
    """The obligation, its literals by name."""
    return _text(build, 0, obligation, name)


def _text(build: Obligations, delay: int, obligation: int, name: Callable[[int], str]) -> str:
    def inner(operand: int) -> str:
        return _text(build, 0, operand, name)

    match build.nodes[obligation]:
        case Truth(value):
            return "true" if value else "false"
        case Now(literal):
            return f"{name(literal)}@{delay}" if delay else name(literal)
        case Later(more, operand):
            return _text(build, delay + more, operand, name)
        case All(members):
            return "(" + " and ".join(_text(build, delay, member, name) for member in members) + ")"
        case Some(members):
            return "(" + " or ".join(_text(build, delay, member, name) for member in members) + ")"
        case Always(last, operand):
            return f"always[{delay}:{delay + last}]({inner(operand)})"
        case Eventually(last, operand):
            return f"eventually[{delay}:{delay + last}]({inner(operand)})"
        case Until(last, left, right):
            text = f"({inner(left)} until[0:{last}] {inner(right)})"
            return f"{text}@{delay}" if delay else text
