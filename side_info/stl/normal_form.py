"""Formulas to normal form over one numbering of predicates.

The normal form of a formula is implied by it, and equal to it but for closures: ``<`` means ``<=``, and what negates a
predicate is the closure of its complement. Negations are pushed down to the comparisons, with the closed until

    p until[a:b] q  =  some time t1 in [a, b] has q, and p holds from now up to and including t1

whose negation needs a case distinction: p fails by a; or q fails on all of [a, b]; or p first fails at some time t of
[a, b], and q fails from a until then. With ``p' = not p``, ``q' = not q`` that is

    eventually[0:a](p')  or  always[a:b](q')  or  (eventually[a:b](p') and always[a:a]((q' or p') until[0:b-a] p'))

where the until may ask for ``q' or p'`` at the witness, since p' holds there. With a = 0 the second and the until say
it all. On a grid of samples that has none at a, ``always[a:a]`` says nothing (outer).
"""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import Final

from side_info.documents.source_location import Excerpt
from side_info.stl.ast import Always, And, Comparison, Eventually, Formula, Implies, Not, Or, Region, Until
from side_info.stl.connectives import FALSE, TRUE, conjunction, disjunction, operands_of, size_of
from side_info.stl.expression import Negation, Sum, names_of
from side_info.stl.inequality import Atom, Budget, not_negative
from side_info.stl.nnf import Conjunction, Disjunction, Finally, Globally, Literal, Normal, reach_ns
from side_info.stl.nnf import Until as NormalUntil
from side_info.stl.predicates import LinearPredicate, Predicate
from side_info.stl.windows import MAX_SECONDS, window_ns

#: Predicates that the formulas of one scenario may come to.
MAX_PREDICATES: Final = 256

#: Literals, constants and operators of one normal form.
MAX_SIZE: Final = 4096

_NAME_LENGTH: Final = 80


@dataclass(slots=True)
class NormalForms:
    """Predicates by number, and the regions; both grow. Formulas may name the regions that were added before."""

    _numbers: dict[Predicate, int] = field(default_factory=dict)
    _names: list[str] = field(default_factory=list)
    _regions: dict[str, tuple[Formula, Excerpt]] = field(default_factory=dict)
    _known: dict[tuple[str, bool], Normal] = field(default_factory=dict)
    budget: Budget = field(default_factory=Budget)

    def add_region(self, name: str, formula: Formula, excerpt: Excerpt, axes: tuple[str, ...] = ()) -> None:
        """Add a region without temporal operators; its predicates are named by it, and by ``axes`` or counted.

        Raises ``ScenarioError`` as ``of`` does.
        """
        self._regions[name] = (formula, excerpt)
        before = len(self._names)
        normal = self._known[name, True] = self.of(formula, excerpt)
        literals = list(dict.fromkeys(literals_in(normal)))
        for index, number in enumerate(literals):
            if number >= before:
                suffix = axes[index] if axes else str(index + 1)
                self._names[number] = name if len(literals) == 1 and not axes else f"{name}.{suffix}"

    def of(self, formula: Formula, excerpt: Excerpt, *, holds: bool = True) -> Normal:
        """Normal form of a formula, or of its negation.

        Raises ``ScenarioError`` for a comparison that can never hold, numbers that are none, and formulas that come to
        too much.
        """
        normal = _Reader(self, excerpt).read(formula, holds)
        if reach_ns(normal) > MAX_SECONDS * 1e9:
            raise excerpt.error(formula.at, f"its windows reach more than {MAX_SECONDS:g} s into the future")
        return normal

    def region(self, name: str, *, holds: bool = True) -> Normal:
        """Normal form of a region, or of its complement."""
        if (name, holds) not in self._known:
            before = len(self._names)
            self._known[name, holds] = self.of(*self._regions[name], holds=holds)
            for number in range(before, len(self._names)):
                self._names[number] = f"not {name}"
        return self._known[name, holds]

    def predicates(self) -> tuple[Predicate, ...]:
        """The predicates by number, each with a name of its own."""
        names = [_shortened(name) for name in self._names]
        unique = [
            name if names.count(name) == 1 else f"{name}#{names[: index + 1].count(name)}"
            for index, name in enumerate(names)
        ]
        return tuple(replace(predicate, name=name) for predicate, name in zip(self._numbers, unique, strict=True))

    def number(self, predicate: Predicate, name: str) -> Literal | None:
        """The literal of a predicate, named so if it is new; None if there are too many."""
        if predicate not in self._numbers:
            if len(self._numbers) >= MAX_PREDICATES:
                return None
            self._numbers[predicate] = len(self._numbers)
            self._names.append(name)
        return Literal(self._numbers[predicate])


def literals_in(formula: Normal) -> Iterator[int]:
    """Numbers of the predicates of a normal formula, from left to right."""
    if isinstance(formula, Literal):
        yield formula.predicate
    for operand in operands_of(formula):
        yield from literals_in(operand)


@dataclass(slots=True)
class _Reader:
    """One formula; ``left`` is how much larger its normal form may become."""

    forms: NormalForms
    excerpt: Excerpt
    left: int = MAX_SIZE

    def read(self, formula: Formula, holds: bool) -> Normal:
        """Normal form of the formula where ``holds``, else of its negation."""
        self._spend(1, formula)
        match formula:
            case Not(operand):
                return self.read(operand, not holds)
            case And(operands) | Or(operands):
                parts = [self.read(operand, holds) for operand in operands]
                return conjunction(parts) if isinstance(formula, And) == holds else disjunction(parts)
            case Implies(left, right):
                parts = [self.read(left, not holds), self.read(right, holds)]
                return disjunction(parts) if holds else conjunction(parts)
            case Always(start, end, operand):
                window = window_ns(start, end)
                return (globally if holds else finally_)(*window, self.read(operand, holds))
            case Eventually(start, end, operand):
                window = window_ns(start, end)
                return (finally_ if holds else globally)(*window, self.read(operand, holds))
            case Until(start, end, left, right):
                return self._until(formula, self.read(left, holds), self.read(right, holds), holds)
            case Region(name):
                region = self.forms.region(name, holds=holds)
                self._spend(size_of(region), formula)
                return region
            case Comparison():
                return self._comparison(formula) if holds else self._negated(formula)
        raise TypeError(f"{type(formula).__name__} is no kind of formula")

    def _until(self, formula: Until, left: Normal, right: Normal, holds: bool) -> Normal:
        start, end = window_ns(formula.start, formula.end)
        if holds:
            return FALSE if right == FALSE else NormalUntil(start, end, left, right)
        self._spend(3 * size_of(left) + size_of(right), formula)
        first = NormalUntil(0, end - start, disjunction((right, left)), left)
        if start == 0:
            return disjunction((globally(0, end, right), first))
        return disjunction(
            (
                finally_(0, start, left),
                globally(start, end, right),
                conjunction((finally_(start, end, left), globally(start, start, first))),
            )
        )

    def _comparison(self, comparison: Comparison) -> Normal:
        """All pairs of the chain; one strip if they are parallel."""
        parts = [(self._structure(pair, strict), name) for pair, name, strict in _differences(comparison)]
        if any(part == FALSE for part, _ in parts) and any(map(names_of, comparison.operands)):
            raise self.excerpt.error(comparison.at, f"{str(comparison)[:60]} can never hold")
        merged = self._merged(comparison, [part for part, _ in parts if part != TRUE])
        if merged is not None:
            return self._literal(merged, str(comparison), comparison)
        return conjunction(self._numbered(part, name, comparison) for part, name in parts)

    def _negated(self, comparison: Comparison) -> Normal:
        """One pair of the chain fails."""
        parts = []
        for pair, name, strict in _differences(comparison):
            part = self._structure(Negation(pair, at=pair.at), not strict)
            parts.append(self._numbered(part, f"not {name}", comparison))
        return disjunction(parts)

    def _structure(self, expression: Sum | Negation, strict: bool) -> Normal:
        return not_negative(expression, self.excerpt, self.forms.budget, strict=strict)

    def _merged(self, comparison: Comparison, parts: list[Normal]) -> LinearPredicate | None:
        """One strip that means all of the parts, if they are parallel."""
        linear = [p.predicate for p in parts if isinstance(p, Atom) and isinstance(p.predicate, LinearPredicate)]
        if len(linear) < max(1, len(parts)) or any(p.coefficients != linear[0].coefficients for p in linear):
            return None
        lower, upper = max(part.lower for part in linear), min(part.upper for part in linear)
        if lower > upper:
            raise self.excerpt.error(comparison.at, f"can never hold: {lower:g} > {upper:g}")
        return replace(linear[0], lower=lower, upper=upper)

    def _numbered(self, structure: Normal, name: str, comparison: Comparison) -> Normal:
        match structure:
            case Atom(predicate):
                return self._literal(predicate, name, comparison)
            case Conjunction(operands):
                return conjunction(self._numbered(operand, name, comparison) for operand in operands)
            case Disjunction(operands):
                return disjunction(self._numbered(operand, name, comparison) for operand in operands)
        return structure

    def _literal(self, predicate: Predicate, name: str, comparison: Comparison) -> Literal:
        self._spend(1, comparison)
        literal = self.forms.number(predicate, name)
        if literal is None:
            raise self.excerpt.error(
                comparison.at,
                f"more than {MAX_PREDICATES} predicates: expected fewer, those of unused regions count too",
            )
        return literal

    def _spend(self, size: int, formula: Formula) -> None:
        """Regions made of regions made of regions could come to any size."""
        self.left -= size
        if self.left < 0:
            raise self.excerpt.error(formula.at, f"the formula comes to more than {MAX_SIZE} parts: expected fewer")


def globally(start_ns: int, end_ns: int, operand: Normal) -> Normal:
    """``operand`` at every time of the window."""
    return TRUE if operand == TRUE else Globally(start_ns, end_ns, operand)


def finally_(start_ns: int, end_ns: int, operand: Normal) -> Normal:
    """``operand`` at some time of the window."""
    return FALSE if operand == FALSE else Finally(start_ns, end_ns, operand)


def _differences(comparison: Comparison) -> Iterator[tuple[Sum, str, bool]]:
    """Expressions that are not negative where the comparison holds, each with its text; whether zero is not allowed."""
    for left, sign, right in zip(comparison.operands, comparison.operators, comparison.operands[1:], strict=False):
        name, strict = f"{left} {sign} {right}", sign in ("<", ">")
        if sign[0] != ">":
            yield Sum((right, Negation(left, at=left.at)), at=left.at), name, strict
        if sign[0] != "<":
            yield Sum((left, Negation(right, at=right.at)), at=left.at), name, strict


def _shortened(name: str) -> str:
    return name if len(name) <= _NAME_LENGTH else name[: _NAME_LENGTH - 1] + "…"
