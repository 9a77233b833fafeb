"""Contradictions that are certain: what no state can satisfy, at one time or on a window.

This is no decision procedure. What it finds is a contradiction; what it does not find may be one all the same.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from fractions import Fraction
from itertools import islice, product
from typing import Final, TypeVar

from fleet_bus.errors import ScenarioError
from side_info.documents.source_location import Excerpt
from side_info.stl.ast import Always, And, Atom, Eventually, Formula, Implies, Not, Or, Temporal, Until, formulas_in
from side_info.stl.connectives import FALSE
from side_info.stl.expression import number_text
from side_info.stl.nnf import Conjunction, Disjunction, Literal, Normal
from side_info.stl.normal_form import NormalForms
from side_info.stl.predicates import DiscPredicate, LinearPredicate, Predicate

# Combinations of alternatives that are looked at, and demands on windows.
_MOST: Final = 256

_T = TypeVar("_T")
Signed = tuple[Formula, bool]
_Interval = tuple[Fraction | None, Fraction | None]


@dataclass(frozen=True, slots=True)
class Conflict:
    """What cannot hold together, in words, at a time from ``start`` to ``end`` (seconds)."""

    words: str
    start: float
    end: float


@dataclass(frozen=True, slots=True)
class _Demand:
    """All of ``parts`` (without time) hold at each time of a window, or (not ``every``) at one of them."""

    start: float
    end: float
    every: bool
    parts: tuple[Signed, ...]


def conflicts(formula: Formula, forms: NormalForms, *, holds: bool = True) -> Iterator[Conflict]:
    """Windows on which the formula (or, not ``holds``, its negation) asks for what no state satisfies."""
    demands = _demands(formula, holds)
    every = [demand for demand in demands if demand.every][:_MOST]
    for demand in demands:
        if not demand.every:
            throughout = [e for e in every if e.start <= demand.start and demand.end <= e.end]
            words = impossible([part for e in (demand, *throughout) for part in e.parts], forms)
            if words:
                yield Conflict(words, demand.start, demand.end)
    for start in sorted({demand.start for demand in every}):
        active = [e for e in every if e.start <= start <= e.end]
        words = impossible([part for e in active for part in e.parts], forms)
        if words:
            yield Conflict(words, start, min(e.end for e in active))


def impossible(parts: Sequence[Signed], forms: NormalForms) -> str | None:
    """Words for why no state satisfies all of the formulas (negated where False), none of them with time; else None."""
    found: str | None = None
    for count, branch in enumerate(_branches(parts)):
        atoms = dict.fromkeys(branch)
        words = next((f"{atom} and not {atom}" for atom, sign in atoms if sign and (atom, False) in atoms), None)
        words = words or _no_state(atoms, forms)
        if words is None or count >= _MOST:
            return None
        found = found or words
    return found or "no alternative"


def _demands(formula: Formula, holds: bool) -> list[_Demand]:
    """Demands that follow from the formula (or its negation)."""
    if not any(isinstance(part, Temporal) for part in formulas_in(formula)):
        return [_Demand(0.0, 0.0, True, ((formula, holds),))]
    match formula:
        case Not(operand):
            return _demands(operand, not holds)
        case And(operands) if holds:
            return [demand for operand in operands for demand in _demands(operand, True)]
        case Or(operands) if not holds:
            return [demand for operand in operands for demand in _demands(operand, False)]
        case Implies(left, right) if not holds:
            return _demands(left, True) + _demands(right, False)
        case Always(start, end, operand) | Eventually(start, end, operand):
            parts = _now(operand, holds)
            return [_Demand(start, end, isinstance(formula, Always) == holds, parts)] if parts else []
        case Until(start, end, left, right) if holds:
            both = _now(left, True) + _now(right, True)
            return [_Demand(0.0, start, True, _now(left, True)), _Demand(start, end, False, both)]
    return []


def _now(formula: Formula, holds: bool) -> tuple[Signed, ...]:
    """What the formula asks for at the very time at which it is to hold."""
    return tuple(
        part
        for demand in _demands(formula, holds)
        if demand.every and demand.start == demand.end == 0
        for part in demand.parts
    )


def _branches(parts: Sequence[Signed]) -> Iterator[tuple[tuple[Atom, bool], ...]]:
    """Alternatives (atoms, or their negations) one of which holds where all of the parts do."""
    for choice in product(*(_few(_alternatives(*part)) for part in parts)):
        yield tuple(signed for atoms in choice for signed in atoms)


def _alternatives(formula: Formula, holds: bool) -> Iterator[tuple[tuple[Atom, bool], ...]]:
    match formula:
        case Not(operand):
            yield from _alternatives(operand, not holds)
        case Implies(left, right):
            yield from _alternatives(Or((Not(left), right)), holds)
        case And(operands) | Or(operands):
            signed = [(operand, holds) for operand in operands]
            if isinstance(formula, And) == holds:
                yield from _branches(signed)
            else:
                for part in signed:
                    yield from _alternatives(*part)
        case Atom():
            yield ((formula, holds),)


def _few(alternatives: Iterator[_T]) -> tuple[_T, ...]:
    """The alternatives, or so many of them that nothing is concluded."""
    return tuple(islice(alternatives, _MOST + 1))


def _no_state(atoms: Iterable[tuple[Atom, bool]], forms: NormalForms) -> str | None:
    """Words for why no state satisfies all of the atoms, in normal form; None if one might."""
    signed = list(atoms)
    try:
        normals = [forms.of(atom, Excerpt.alone("", "lint"), holds=sign) for atom, sign in signed]
    except ScenarioError:
        # There are too many predicates by now: nothing is known.
        return None
    predicates = forms.predicates()
    cases = product(*(_few(_cases(normal)) for normal in normals))
    for count, case in enumerate(cases):
        if count >= _MOST or not _contradictory([predicates[number] for numbers in case for number in numbers]):
            return None
    return " and ".join(dict.fromkeys(f"{atom}" if sign else f"not {atom}" for atom, sign in signed))


def _cases(formula: Normal) -> Iterator[tuple[int, ...]]:
    """Sets of predicates one of which holds where a formula without time does."""
    match formula:
        case Literal(predicate):
            yield (predicate,)
        case Conjunction(operands):
            for choice in product(*(_few(_cases(operand)) for operand in operands)):
                yield tuple(number for numbers in choice for number in numbers)
        case Disjunction(operands):
            for operand in operands:
                yield from _cases(operand)
        case _ if formula != FALSE:
            yield ()


def _contradictory(predicates: Sequence[Predicate]) -> bool:
    """Whether strips and discs have surely no state in common (exact in rational arithmetic)."""
    strips: dict[tuple[tuple[str, Fraction], ...], _Interval] = {}
    for direction, interval in (found for predicate in predicates for found in _strips(predicate)):
        strips[direction] = _meet(strips.get(direction, (None, None)), interval)
    box = {direction[0][0]: interval for direction, interval in strips.items() if len(direction) == 1}
    for direction, (lower, upper) in strips.items():
        least, most = _range(direction, box)
        if (lower is not None and most is not None and lower > most) or (
            upper is not None and least is not None and upper < least
        ):
            return True
    return any(isinstance(predicate, DiscPredicate) and _apart(predicate, box) for predicate in predicates)


def _strips(predicate: Predicate) -> Iterator[tuple[tuple[tuple[str, Fraction], ...], _Interval]]:
    """Strips that contain the predicate, each with first coefficient 1."""
    if isinstance(predicate, LinearPredicate):
        first = Fraction(next(iter(predicate.coefficients.values())))
        direction = tuple((name, Fraction(c) / first) for name, c in predicate.coefficients.items())
        bounds = [None if abs(b) == float("inf") else Fraction(b) / first for b in (predicate.lower, predicate.upper)]
        yield direction, (bounds[0], bounds[1])
    elif isinstance(predicate, DiscPredicate):
        radius = Fraction(predicate.radius)
        for name, center in predicate.center.items():
            yield ((name, Fraction(1)),), (Fraction(center) - radius, Fraction(center) + radius)


def _meet(a: _Interval, b: _Interval) -> _Interval:
    lower = [bound for bound in (a[0], b[0]) if bound is not None]
    upper = [bound for bound in (a[1], b[1]) if bound is not None]
    return max(lower, default=None), min(upper, default=None)


def _range(direction: tuple[tuple[str, Fraction], ...], box: dict[str, _Interval]) -> _Interval:
    """Least and largest value of a sum of states in a box, None where it has no bound."""
    ends: list[Fraction | None] = [Fraction(0), Fraction(0)]
    for name, c in direction:
        lower, upper = box.get(name, (None, None))
        for side, bound in enumerate((lower, upper) if c > 0 else (upper, lower)):
            total = ends[side]
            ends[side] = None if total is None or bound is None else total + c * bound
    return ends[0], ends[1]


def _apart(disc: DiscPredicate, box: dict[str, _Interval]) -> bool:
    squared = Fraction(0)
    for name, at in disc.center.items():
        lower, upper = box[name]
        assert lower is not None
        assert upper is not None
        squared += max(lower - Fraction(at), Fraction(at) - upper, Fraction(0)) ** 2
    return squared > Fraction(disc.radius) ** 2


def window_text(start: float, end: float) -> str:
    """A window in words."""
    if start == end:
        return f"at {number_text(start)} s"
    return f"from {number_text(start)} s to {number_text(end)} s"
