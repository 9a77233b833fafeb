"""Conjunctions and disjunctions of normal formulas, without what says nothing."""

from collections.abc import Iterable, Iterator
from typing import Final

from side_info.stl.nnf import Conjunction, Constant, Disjunction, Finally, Globally, Normal, Until

TRUE: Final = Constant(True)
FALSE: Final = Constant(False)


def conjunction(operands: Iterable[Normal]) -> Normal:
    """All of the operands: each once, in their order, nested conjunctions taken apart."""
    parts: dict[Normal, None] = {}
    for operand in operands:
        if operand == FALSE:
            return FALSE
        parts.update(dict.fromkeys(operand.operands if isinstance(operand, Conjunction) else (operand,)))
    parts.pop(TRUE, None)
    return TRUE if not parts else next(iter(parts)) if len(parts) == 1 else Conjunction(tuple(parts))


def disjunction(operands: Iterable[Normal]) -> Normal:
    """One of the operands or more: each once, in their order, nested disjunctions taken apart."""
    parts: dict[Normal, None] = {}
    for operand in operands:
        if operand == TRUE:
            return TRUE
        parts.update(dict.fromkeys(operand.operands if isinstance(operand, Disjunction) else (operand,)))
    parts.pop(FALSE, None)
    return FALSE if not parts else next(iter(parts)) if len(parts) == 1 else Disjunction(tuple(parts))


def operands_of(formula: Normal) -> tuple[Normal, ...]:
    """What a normal formula is made of; nothing for a literal or constant."""
    match formula:
        case Conjunction(operands) | Disjunction(operands):
            return operands
        case Globally(_, _, operand) | Finally(_, _, operand):
            return (operand,)
        case Until(_, _, left, right):
            return (left, right)
    return ()


def bounds_ns(formula: Normal) -> Iterator[int]:
    """Ends of all windows of the formula."""
    if isinstance(formula, Globally | Finally | Until):
        yield from (formula.start_ns, formula.end_ns)
    for operand in operands_of(formula):
        yield from bounds_ns(operand)


def size_of(formula: Normal) -> int:
    """How many literals, constants and operators a normal formula has."""
    return 1 + sum(map(size_of, operands_of(formula)))
