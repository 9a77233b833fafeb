"""Formulas of signal temporal logic: syntax tree and text."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Final

from lark import Token, Tree

from side_info.documents.source_location import Excerpt
from side_info.stl.arithmetic import build_expression, undeclared
from side_info.stl.declarations import Declarations
from side_info.stl.expression import Expression, number_text
from side_info.stl.parser import Branch, start_of, syntax_tree
from side_info.stl.windows import check_window, read_window

_LOGIC: Final = ("conjunction", "disjunction", "negated", "implies", "always", "eventually", "until")
_ARITHMETIC: Final = ("sum", "product", "negation", "reciprocal", "power")
_WORDS: Final = ("OR", "NOT", "IMPLIES", "ALWAYS", "EVENTUALLY", "UNTIL")


@dataclass(frozen=True, slots=True)
class Formula:
    """A formula of signal temporal logic [MaN04]; ``at`` is its place in the text it was read from, no part of its
    value.

    ``str`` gives text in the canonical dialect, without parameters, that reads back as an equal formula. Formulas
    combine by ``&``, ``|``, ``~``, ``>>`` (implies) and the methods, whose windows are in seconds from now, both ends
    included; bounds that make no window raise ``ScenarioError``.
    """

    at: int = field(default=0, compare=False, repr=False, kw_only=True)

    @staticmethod
    def parse(text: str, declared: Declarations, source: str = "formula") -> "Formula":
        """Formula of ``text`` over the names of ``declared``.

        Raises ``ScenarioError`` with ``source``, line, column and a caret for what is no formula or uses names that are
        not declared.
        """
        return parse_excerpt(Excerpt.alone(text, source), declared)

    def __and__(self, other: "Formula") -> "And":
        return And((*_operands(self, And), *_operands(other, And)))

    def __or__(self, other: "Formula") -> "Or":
        return Or((*_operands(self, Or), *_operands(other, Or)))

    def __invert__(self) -> "Not":
        return Not(self)

    def __rshift__(self, other: "Formula") -> "Implies":
        return Implies(self, other)

    def always(self, start: float, end: float) -> "Always":
        """This formula at every time of the window."""
        return Always(start, end, self)

    def eventually(self, start: float, end: float) -> "Eventually":
        """This formula at some time of the window."""
        return Eventually(start, end, self)

    def until(self, other: "Formula", start: float, end: float) -> "Until":
        """``other`` at some time of the window, and this formula from now up to and including that time."""
        return Until(start, end, self, other)


@dataclass(frozen=True, slots=True)
class And(Formula):
    """All of two or more formulas."""

    operands: tuple[Formula, ...]

    def __str__(self) -> str:
        return " and ".join(_in_parentheses(operand, And, Or, Implies) for operand in self.operands)


@dataclass(frozen=True, slots=True)
class Or(Formula):
    """One of two or more formulas, or several."""

    operands: tuple[Formula, ...]

    def __str__(self) -> str:
        return " or ".join(_in_parentheses(operand, Or, Implies) for operand in self.operands)


@dataclass(frozen=True, slots=True)
class Not(Formula):
    """``operand`` does not hold."""

    operand: Formula

    def __str__(self) -> str:
        return f"not {_in_parentheses(self.operand, And, Or, Implies, Until)}"


@dataclass(frozen=True, slots=True)
class Implies(Formula):
    """If ``left`` holds, ``right`` does."""

    left: Formula
    right: Formula

    def __str__(self) -> str:
        return f"{_in_parentheses(self.left, Implies)} -> {self.right}"


@dataclass(frozen=True, slots=True)
class Temporal(Formula):
    """A formula about the times from ``start`` to ``end``, both included, in seconds from now.

    Raises ``ScenarioError`` for bounds that make no window.
    """

    start: float
    end: float

    def __post_init__(self) -> None:
        check_window(self.start, self.end)

    @property
    def window(self) -> str:
        """Text of the window."""
        return f"[{number_text(self.start)}:{number_text(self.end)}]"


@dataclass(frozen=True, slots=True)
class Always(Temporal):
    """``operand`` at every time of the window."""

    operand: Formula

    def __str__(self) -> str:
        return f"always{self.window}({self.operand})"


@dataclass(frozen=True, slots=True)
class Eventually(Temporal):
    """``operand`` at some time of the window."""

    operand: Formula

    def __str__(self) -> str:
        return f"eventually{self.window}({self.operand})"


@dataclass(frozen=True, slots=True)
class Until(Temporal):
    """``right`` at some time of the window, and ``left`` from now up to and including that time."""

    left: Formula
    right: Formula

    def __str__(self) -> str:
        left, right = (_in_parentheses(side, And, Or, Implies, Until) for side in (self.left, self.right))
        return f"{left} until{self.window} {right}"


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
    """``operands`` compared pair by pair by ``operators``: one fewer, of ``< <= ==`` or of ``> >= ==``."""

    operands: tuple[Expression, ...]
    operators: tuple[str, ...]

    def __str__(self) -> str:
        first, *rest = self.operands
        return str(first) + "".join(f" {sign} {operand}" for sign, operand in zip(self.operators, rest, strict=True))


def formulas_in(formula: Formula) -> Iterator[Formula]:
    """The formula and all that it is made of, each before its operands."""
    yield formula
    match formula:
        case And(operands) | Or(operands):
            parts: tuple[Formula, ...] = operands
        case Not(operand) | Always(_, _, operand) | Eventually(_, _, operand):
            parts = (operand,)
        case Implies(left, right) | Until(_, _, left, right):
            parts = (left, right)
        case _:
            parts = ()
    for part in parts:
        yield from formulas_in(part)


def parse_excerpt(excerpt: Excerpt, declared: Declarations) -> Formula:
    """As ``Formula.parse``, of text that stands in a document."""
    return _build(syntax_tree(excerpt), excerpt, declared)


def _operands(formula: Formula, kind: type[And] | type[Or]) -> tuple[Formula, ...]:
    return formula.operands if isinstance(formula, kind) else (formula,)


def _in_parentheses(formula: Formula, *kinds: type[Formula]) -> str:
    return f"({formula})" if isinstance(formula, kinds) else str(formula)


def _build(branch: Branch, excerpt: Excerpt, declared: Declarations) -> Formula:
    at = start_of(branch)
    if isinstance(branch, Token):
        return _region(branch, excerpt, declared)
    if branch.data == "comparison":
        return _comparison(branch.children, excerpt, declared)
    if branch.data == "call" and branch.children[0] == "in":
        return _membership(branch.children, excerpt, declared)
    if branch.data not in _LOGIC:
        # It is arithmetic: what is wrong inside is said first.
        expression = build_expression(branch, excerpt, declared)
        raise excerpt.error(at, f"a formula is expected, {str(expression)[:40]!r} is a number: compare it with another")
    _check_arrow(branch, excerpt, declared)
    start = end = 0.0
    operands: tuple[Formula, ...] = ()
    for child in branch.children:
        if not isinstance(child, Token) and child.data == "window":
            start, end = read_window(child, excerpt, declared)
        elif not isinstance(child, Token) or child.type not in _WORDS:
            operands += (_build(child, excerpt, declared),)
    match branch.data:
        case "conjunction":
            return And(operands, at=at)
        case "disjunction":
            return Or(operands, at=at)
        case "negated":
            return Not(*operands, at=at)
        case "implies":
            return Implies(*operands, at=at)
        case "always":
            return Always(start, end, *operands, at=at)
        case "eventually":
            return Eventually(start, end, *operands, at=at)
        case _:
            return Until(start, end, *operands, at=at)


def _check_arrow(branch: Tree[Token], excerpt: Excerpt, declared: Declarations) -> None:
    """Tell who writes ``x => 2`` for ``x >= 2`` what went wrong."""
    if branch.data != "implies":
        return
    left, arrow, _ = branch.children
    # In "P and x => 2" it is the last operand that stands beside the arrow.
    while not isinstance(left, Token) and left.data in ("conjunction", "disjunction"):
        left = left.children[-1]
    if isinstance(left, Token):
        number = left not in declared.regions
    else:
        number = left.data in _ARITHMETIC or (left.data == "call" and left.children[0] != "in")
    if arrow == "=>" and number:
        raise excerpt.error(start_of(arrow), "'=>' means implies: for a comparison write >=")


def _region(token: Token, excerpt: Excerpt, declared: Declarations) -> Region:
    if token in declared.regions:
        return Region(str(token), at=start_of(token))
    if token.type == "NUMBER" or token in declared.states or token in declared.parameters or token in ("t", "k"):
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


def _comparison(children: list[Branch], excerpt: Excerpt, declared: Declarations) -> Comparison:
    operators = [child for child in children[1::2] if isinstance(child, Token)]
    directed = [operator for operator in operators if operator != "=="]
    for operator in directed:
        if operator[0] != directed[0][0]:
            raise excerpt.error(
                start_of(operator), f"'{directed[0]}' and '{operator}' in one chain: expected one direction"
            )
    operands = tuple(build_expression(child, excerpt, declared) for child in children[::2])
    return Comparison(operands, tuple(map(str, operators)), at=operands[0].at)
