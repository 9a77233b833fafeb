"""Arithmetic over declared names: syntax tree and text."""

import math
from dataclasses import dataclass, field
from typing import Final

from lark import Token

from fleet_bus.errors import ScenarioError
from side_info.declarations import FUNCTIONS, LATER_FUNCTIONS, Declarations
from side_info.parser import Branch, start_of
from side_info.places import Excerpt

# How tightly each kind binds; an operand that binds less tightly than its place allows gets parentheses.
_SUM: Final = 1
_PRODUCT: Final = 2
_SIGN: Final = 3
_POWER: Final = 4
_OPERAND: Final = 5


@dataclass(frozen=True, slots=True)
class Expression:
    """An arithmetic expression; ``at`` is its place in the text it was read from, no part of its value.

    ``str`` gives text in the canonical dialect that reads back as an equal expression.
    """

    at: int = field(default=0, compare=False, repr=False, kw_only=True)

    def __str__(self) -> str:
        return _print(self, _SUM)


@dataclass(frozen=True, slots=True)
class Number(Expression):
    """A finite number that is not negative (a negative one is the ``Negation`` of a number)."""

    value: float


@dataclass(frozen=True, slots=True)
class Name(Expression):
    """The value of a state."""

    name: str


@dataclass(frozen=True, slots=True)
class Sum(Expression):
    """Sum of two or more terms; a subtracted term is a ``Negation``."""

    terms: tuple[Expression, ...]


@dataclass(frozen=True, slots=True)
class Product(Expression):
    """Product of two or more factors; a divisor is a ``Reciprocal`` and never comes first."""

    factors: tuple[Expression, ...]


@dataclass(frozen=True, slots=True)
class Negation(Expression):
    """The operand with its sign changed."""

    operand: Expression


@dataclass(frozen=True, slots=True)
class Reciprocal(Expression):
    """One divided by the operand."""

    operand: Expression


@dataclass(frozen=True, slots=True)
class Power(Expression):
    """``base`` to the ``exponent``."""

    base: Expression
    exponent: Expression


@dataclass(frozen=True, slots=True)
class Call(Expression):
    """One of ``abs`` (one argument), ``norm`` and ``sumsqr`` (Euclidean norm and its square, one or more)."""

    function: str
    arguments: tuple[Expression, ...]


def number_text(value: float) -> str:
    """Shortest text that reads back as ``value``."""
    return repr(value).removesuffix(".0")


def build_expression(branch: Branch, excerpt: Excerpt, declared: Declarations) -> Expression:
    """Expression of a branch of the syntax tree; raise ``ScenarioError`` if it is none over ``declared``."""
    at = start_of(branch)
    if isinstance(branch, Token):
        return _number(branch, excerpt) if branch.type == "NUMBER" else _name(branch, excerpt, declared)
    if branch.data == "call":
        return _call(branch.children, excerpt, declared)
    if branch.data not in ("sum", "product", "negation", "reciprocal", "power"):
        raise excerpt.error(at, "a number is expected, a formula came")
    operands = tuple(build_expression(child, excerpt, declared) for child in branch.children)
    match branch.data:
        case "sum":
            return Sum(operands, at=at)
        case "product":
            return Product(operands, at=at)
        case "negation":
            return Negation(*operands, at=at)
        case "reciprocal":
            return Reciprocal(*operands, at=at)
        case _:
            return Power(*operands, at=at)


def read_number(token: Token, excerpt: Excerpt) -> float:
    """Value of a number; raise ``ScenarioError`` if it is not finite or too small to be told from zero."""
    value = float(token)
    if math.isinf(value) or (value == 0.0 and token.lower().split("e")[0].strip("0.")):
        raise excerpt.error(start_of(token), f"{token:.40} is not a number of double precision: expected a finite one")
    return value


def undeclared(token: Token, excerpt: Excerpt, declared: Declarations) -> ScenarioError:
    """Error about a name that is not declared."""
    return excerpt.error(start_of(token), f"{token[:40]!r} is not declared: declared are {declared.describe()}")


def _number(token: Token, excerpt: Excerpt) -> Number:
    return Number(read_number(token, excerpt), at=start_of(token))


def _name(token: Token, excerpt: Excerpt, declared: Declarations) -> Expression:
    at = start_of(token)
    if token in declared.states:
        return Name(str(token), at=at)
    if token in declared.parameters:
        value = declared.parameters[token]
        number = Number(abs(value), at=at)
        return Negation(number, at=at) if value < 0 else number
    if token in declared.regions:
        raise excerpt.error(at, f"a number is expected, {str(token)!r} is a region")
    raise undeclared(token, excerpt, declared)


def _call(children: list[Branch], excerpt: Excerpt, declared: Declarations) -> Call:
    function, *arguments = children
    at = start_of(function)
    if function in LATER_FUNCTIONS:
        raise excerpt.error(at, f"the function {function} is not supported in this version: use {', '.join(FUNCTIONS)}")
    if function == "in":
        raise excerpt.error(at, "a number is expected, in(…) is a formula")
    if function not in FUNCTIONS:
        raise excerpt.error(at, f"unknown function {str(function)[:40]!r}: expected one of {', '.join(FUNCTIONS)}")
    if function == "abs" and len(arguments) != 1:
        raise excerpt.error(start_of(arguments[1]), f"abs takes one argument, {len(arguments)} came")
    built = tuple(build_expression(argument, excerpt, declared) for argument in arguments)
    return Call(str(function), built, at=at)


def _print(expression: Expression, least: int) -> str:
    binding, text = _text(expression)
    return text if binding >= least else f"({text})"


def _text(expression: Expression) -> tuple[int, str]:
    match expression:
        case Number(value):
            return _OPERAND, number_text(value)
        case Name(name):
            return _OPERAND, name
        case Call(function, arguments):
            return _OPERAND, f"{function}({', '.join(str(argument) for argument in arguments)})"
        case Power(base, exponent):
            return _POWER, f"{_print(base, _OPERAND)}^{_print(exponent, _SIGN)}"
        case Negation(operand):
            return _SIGN, f"-{_print(operand, _SIGN)}"
        case Reciprocal(operand):
            return _PRODUCT, f"1 / {_print(operand, _SIGN)}"
        case Product(factors):
            return _PRODUCT, _print(factors[0], _SIGN) + "".join(map(_factor, factors[1:]))
        case Sum(terms):
            return _SUM, _print(terms[0], _PRODUCT) + "".join(map(_term, terms[1:]))
    raise TypeError(f"{type(expression).__name__} is no expression of this version")


def _factor(factor: Expression) -> str:
    if isinstance(factor, Reciprocal):
        return f" / {_print(factor.operand, _SIGN)}"
    return f" * {_print(factor, _SIGN)}"


def _term(term: Expression) -> str:
    if isinstance(term, Negation):
        return f" - {_print(term.operand, _PRODUCT)}"
    return f" + {_print(term, _PRODUCT)}"
