"""What an obligation is made of: formulas over samples, in whole steps from now.

An obligation is a number; its operands are numbers too (``Obligations`` keeps which node a number stands for).
"""

from dataclasses import dataclass
from typing import Final

TRUE: Final = 0
"""The obligation that every sequence of samples fulfils."""
FALSE: Final = 1
"""The obligation that no sequence of samples fulfils."""


@dataclass(frozen=True, slots=True)
class Truth:
    """True or false."""

    value: bool


@dataclass(frozen=True, slots=True)
class Now:
    """The literal with this number holds at this sample."""

    literal: int


@dataclass(frozen=True, slots=True)
class All:
    """Each of the members, in the order of their numbers; none of them entails another."""

    members: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class Some:
    """One of the members, or more, in the order of their numbers; none of them entails another."""

    members: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class Always:
    """The operand at samples 0 to ``last`` from now."""

    last: int
    operand: int


@dataclass(frozen=True, slots=True)
class Eventually:
    """The operand at one of the samples 0 to ``last`` from now."""

    last: int
    operand: int


@dataclass(frozen=True, slots=True)
class Until:
    """``right`` at one of the samples 0 to ``last`` from now, and ``left`` at all before that one."""

    last: int
    left: int
    right: int


@dataclass(frozen=True, slots=True)
class Later:
    """The operand, ``delay`` samples from now."""

    delay: int
    operand: int


Node = Truth | Now | All | Some | Always | Eventually | Until | Later
