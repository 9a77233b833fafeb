"""Arithmetic over declared names: syntax tree and text."""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import Final

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
class Time(Expression):
    """``t``: seconds since the scenario's time zero."""


@dataclass(frozen=True, slots=True)
class Steps(Expression):
    """``k``: how many samples ahead of the last received one the state is, 0 for a received state."""


@dataclass(frozen=True, slots=True)
class Last(Expression):
    """``last(x)``: the state ``x`` as it was at the last received sample; ``last(t)``: when that was."""

    name: str


@dataclass(frozen=True, slots=True)
class Call(Expression):
    """One of ``FUNCTIONS``: ``abs sqrt exp log sin cos tan`` (one argument), ``atan2`` (two), ``hypot norm sumsqr``
    (Euclidean norm, and its square; one or more), ``min max`` (one or more)."""

    function: str
    arguments: tuple[Expression, ...]


def number_text(value: float) -> str:
    """Shortest text that reads back as ``value``."""
    return repr(value).removesuffix(".0")


def _print(expression: Expression, least: int) -> str:
    binding, text = _text(expression)
    return text if binding >= least else f"({text})"


def _text(expression: Expression) -> tuple[int, str]:
    match expression:
        case Number(value):
            return _OPERAND, number_text(value)
        case Name(name):
            return _OPERAND, name
        case Time():
            return _OPERAND, "t"
        case Steps():
            return _OPERAND, "k"
        case Last(name):
            return _OPERAND, f"last({name})"
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
    raise TypeError(f"{type(expression).__name__} is no kind of expression")


def _factor(factor: Expression) -> str:
    if isinstance(factor, Reciprocal):
        return f" / {_print(factor.operand, _SIGN)}"
    return f" * {_print(factor, _SIGN)}"


def _term(term: Expression) -> str:
    if isinstance(term, Negation):
        return f" - {_print(term.operand, _PRODUCT)}"
    return f" + {_print(term, _PRODUCT)}"


def parts_of(expression: Expression) -> tuple[Expression, ...]:
    """Operands of an expression, from left to right; none of a number or name."""
    match expression:
        case Sum(parts) | Product(parts) | Call(_, parts):
            return parts
        case Negation(operand) | Reciprocal(operand):
            return (operand,)
        case Power(base, exponent):
            return (base, exponent)
    return ()


def with_parts(expression: Expression, parts: tuple[Expression, ...]) -> Expression:
    """The expression with other operands, as many as ``parts_of`` gives."""
    match expression:
        case Sum():
            return replace(expression, terms=parts)
        case Product():
            return replace(expression, factors=parts)
        case Call():
            return replace(expression, arguments=parts)
        case Negation() | Reciprocal():
            return replace(expression, operand=parts[0])
        case Power():
            return replace(expression, base=parts[0], exponent=parts[1])
    return expression


def nodes_of(expression: Expression) -> Iterator[Expression]:
    """The expression and all that it is made of, each before its operands."""
    yield expression
    for part in parts_of(expression):
        yield from nodes_of(part)


def substituted(expression: Expression, old: Expression, new: Expression) -> Expression:
    """The expression with ``new`` wherever it has ``old``."""
    if expression == old:
        return new
    parts = parts_of(expression)
    return with_parts(expression, tuple(substituted(part, old, new) for part in parts)) if parts else expression


def names_of(expression: Expression) -> frozenset[str]:
    """Names of the states in an expression, without those inside ``last``."""
    return frozenset(node.name for node in nodes_of(expression) if isinstance(node, Name))


def is_number(expression: Expression) -> bool:
    """Whether the expression has one value, whatever the state and the time are."""
    return not any(isinstance(node, Name | Time | Steps | Last) for node in nodes_of(expression))
