"""Negation normal form: what a formula comes to once names, regions, negations and kinks are gone.

A normal formula is a positive formula over numbered predicates, with windows in whole nanoseconds. A negated
predicate has become its closure, so the normal form of a formula is implied by it (outer).
"""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Normal:
    """A formula in normal form."""


@dataclass(frozen=True, slots=True)
class Constant(Normal):
    """True or false, whatever the state is."""

    value: bool


@dataclass(frozen=True, slots=True)
class Literal(Normal):
    """The predicate with this number holds now."""

    predicate: int


@dataclass(frozen=True, slots=True)
class Conjunction(Normal):
    """All of the operands."""

    operands: tuple[Normal, ...]


@dataclass(frozen=True, slots=True)
class Disjunction(Normal):
    """One of the operands, or more."""

    operands: tuple[Normal, ...]


@dataclass(frozen=True, slots=True)
class Globally(Normal):
    """The operand at every time of the window, both ends included, in nanoseconds from now."""

    start_ns: int
    end_ns: int
    operand: Normal


@dataclass(frozen=True, slots=True)
class Finally(Normal):
    """The operand at some time of the window."""

    start_ns: int
    end_ns: int
    operand: Normal


@dataclass(frozen=True, slots=True)
class Until(Normal):
    """``right`` at some time of the window, and ``left`` from now up to and including that time."""

    start_ns: int
    end_ns: int
    left: Normal
    right: Normal


def reach_ns(formula: Normal) -> int:
    """Nanoseconds from now after which nothing that happens matters to the formula."""
    match formula:
        case Conjunction(operands) | Disjunction(operands):
            return max(map(reach_ns, operands), default=0)
        case Globally(_, end_ns, operand) | Finally(_, end_ns, operand):
            return end_ns + reach_ns(operand)
        case Until(_, end_ns, left, right):
            return end_ns + max(reach_ns(left), reach_ns(right))
    return 0
