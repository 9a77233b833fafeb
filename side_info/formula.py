"""Formulas of signal temporal logic: syntax tree, text, and what of the language this version takes.

This version takes conjunctions, ``always[a:b]``, regions and comparisons. The rest of the language is read
and then refused by name.
"""

from dataclasses import dataclass, field
from decimal import Decimal
from typing import Final

from lark import Token

from side_info.declarations import Declarations
from side_info.expression import Expression, build_expression, number_text, read_number, undeclared
from side_info.parser import Branch, start_of, syntax_tree
from side_info.places import Excerpt

#: Latest end of a window, seconds: nanoseconds since a scenario's time zero stay well inside 64 bits.
MAX_SECONDS: Final = 1e9

_LATER: Final = {
    "implies": ("IMPLIES", "implies"),
    "disjunction": ("OR", "or"),
    "until": ("UNTIL", "until"),
    "negated": ("NOT", "not"),
    "eventually": ("EVENTUALLY", "eventually"),
}
_FACTORS: Final = {"ms": Decimal("0.001"), "s": Decimal(1), "min": Decimal(60)}


@dataclass(frozen=True, slots=True)
class Formula:
    """A formula; ``at`` is its place in the text it was read from, no part of its value.

    ``str`` gives text in the canonical dialect, without parameters, that reads back as an equal formula.
    """

    at: int = field(default=0, compare=False, repr=False, kw_only=True)

    @staticmethod
    def parse(text: str, declared: Declarations, source: str = "formula") -> "Formula":
        """Formula of ``text`` over the names of ``declared``.

        Raises ``ScenarioError`` with ``source``, line, column and a caret for what is no formula, uses names
        that are not declared, or is not supported in this version.
        """
        return parse_excerpt(Excerpt.alone(text, source), declared)


@dataclass(frozen=True, slots=True)
class And(Formula):
    """All of two or more formulas."""

    operands: tuple[Formula, ...]

    def __str__(self) -> str:
        texts = (f"({operand})" if isinstance(operand, And) else str(operand) for operand in self.operands)
        return " and ".join(texts)


@dataclass(frozen=True, slots=True)
class Always(Formula):
    """``operand`` at every time from ``start`` to ``end``, both included, in seconds from now."""

    start: float
    end: float
    operand: Formula

    def __str__(self) -> str:
        return f"always[{number_text(self.start)}:{number_text(self.end)}]({self.operand})"


@dataclass(frozen=True, slots=True)
class Atom(Formula):
    """A formula without logic: it speaks about the state at one time."""


@dataclass(frozen=True, slots=True)
class Region(Atom):
    """The state lies in the region of this name."""

    name: str

    def __str__(self) -> str:
        return self.name


@dataclass(frozen=True, slots=True)
class Comparison(Atom):
    """``operands`` compared pair by pair by ``operators``: one fewer, ``< <=`` or ``> >=``."""

    operands: tuple[Expression, ...]
    operators: tuple[str, ...]

    def __str__(self) -> str:
        first, *rest = self.operands
        return str(first) + "".join(f" {sign} {operand}" for sign, operand in zip(self.operators, rest, strict=True))


def parse_excerpt(excerpt: Excerpt, declared: Declarations) -> Formula:
    """As ``Formula.parse``, of text that stands in a document."""
    return _build(syntax_tree(excerpt), excerpt, declared)


def window_ns(start: float, end: float) -> tuple[int, int]:
    """First and last whole nanosecond of the window from ``start`` to ``end``, seconds in decimals.

    Exact where the bounds are whole nanoseconds, else rounded inwards (outer: a predicate that is active for
    less time cuts less).
    """
    # Twelve digits are far below a nanosecond and above what is lost when 9 ms become seconds.
    first, last = (round(Decimal(repr(bound)), 12).scaleb(9) for bound in (start, end))
    return int(first.to_integral_value("ROUND_CEILING")), int(last.to_integral_value("ROUND_FLOOR"))


def _build(branch: Branch, excerpt: Excerpt, declared: Declarations) -> Formula:
    at = start_of(branch)
    if isinstance(branch, Token):
        return _region(branch, excerpt, declared)
    if branch.data in _LATER:
        token_type, word = _LATER[branch.data]
        token = next(child for child in branch.children if isinstance(child, Token) and child.type == token_type)
        hint = "; for a comparison write >=" if token == "=>" else ""
        raise excerpt.error(start_of(token), f"{word!r} is not supported in this version{hint}")
    match branch.data:
        case "conjunction":
            return And(tuple(_build(child, excerpt, declared) for child in branch.children), at=at)
        case "always":
            return _always(branch.children, excerpt, declared)
        case "comparison":
            return _comparison(branch.children, excerpt, declared)
        case "call" if branch.children[0] == "in":
            return _membership(branch.children, excerpt, declared)
    # It is arithmetic: what is wrong inside is said first.
    expression = build_expression(branch, excerpt, declared)
    raise excerpt.error(at, f"a formula is expected, {str(expression)[:40]!r} is a number: compare it with another")


def _region(token: Token, excerpt: Excerpt, declared: Declarations) -> Region:
    if token in declared.regions:
        return Region(str(token), at=start_of(token))
    if token.type == "NUMBER" or token in declared.states or token in declared.parameters:
        raise excerpt.error(
            start_of(token),
            f"a formula is expected, {str(token)[:40]!r} is a number: compare it with another",
        )
    raise undeclared(token, excerpt, declared)


def _membership(children: list[Branch], excerpt: Excerpt, declared: Declarations) -> Region:
    _, *arguments = children
    region = arguments[0]
    if len(arguments) != 1 or not isinstance(region, Token):
        raise excerpt.error(start_of(arguments[-1]), "in(…) takes the name of one region")
    return _region(region, excerpt, declared)


def _always(children: list[Branch], excerpt: Excerpt, declared: Declarations) -> Always:
    word, window, body = children
    assert not isinstance(window, Token)
    start, end = (_bound(child, excerpt, declared) for child in window.children)
    if start > end:
        raise excerpt.error(start_of(window), f"the window is reversed: {number_text(start)} s > {number_text(end)} s")
    first, last = window_ns(start, end)
    if first > last:
        raise excerpt.error(start_of(window), "the window holds no whole nanosecond")
    operand = _build(body, excerpt, declared)
    inner = _first_always(operand)
    if inner is not None:
        raise excerpt.error(inner.at, "'always' inside of 'always' is not supported in this version")
    return Always(start, end, operand, at=start_of(word))


def _first_always(formula: Formula) -> Always | None:
    if isinstance(formula, Always):
        return formula
    operands = formula.operands if isinstance(formula, And) else ()
    return next((found for found in map(_first_always, operands) if found is not None), None)


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
    elif value in declared.states or value in declared.regions:
        raise excerpt.error(at, f"a bound is a number or a parameter, {str(value)!r} is neither")
    else:
        raise undeclared(value, excerpt, declared)
    if not 0 <= seconds <= MAX_SECONDS:
        raise excerpt.error(at, f"a bound of {seconds:g} s: expected 0 to {MAX_SECONDS:g} s")
    return seconds


def _comparison(children: list[Branch], excerpt: Excerpt, declared: Declarations) -> Comparison:
    operators = [child for child in children[1::2] if isinstance(child, Token)]
    for operator in operators:
        if operator == "==":
            raise excerpt.error(start_of(operator), "'==' is not supported in this version: write a <= x <= b")
        if operator[0] != operators[0][0]:
            raise excerpt.error(
                start_of(operator), f"'{operators[0]}' and '{operator}' in one chain: expected one direction"
            )
    operands = tuple(build_expression(child, excerpt, declared) for child in children[::2])
    return Comparison(operands, tuple(map(str, operators)), at=operands[0].at)
