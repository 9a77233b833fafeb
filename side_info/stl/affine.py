"""Expressions as ``constant + sum of coefficient * symbol``, in rational arithmetic.

A symbol is a state, or an expression that is neither a number nor affine (``t``, ``x1 * x2``, ``sin(x3)``). Numbers
mean the decimals that were written; only finished bounds and coefficients are rounded, to the nearest double. Roots
that are not rational have more digits than a double, the other functions of numbers are those of doubles.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction

from side_info.documents.source_location import Excerpt
from side_info.stl.expression import (
    Call,
    Expression,
    Negation,
    Number,
    Power,
    Product,
    Reciprocal,
    Sum,
    is_number,
    parts_of,
    with_parts,
)
from side_info.stl.functions import FUNCTIONS, MAX_BITS, Exact, NoNumberError, bits, nearest_double, of_doubles


@dataclass(frozen=True, slots=True)
class Affine:
    """``constant + sum of coefficients[s] * s``, no coefficient zero."""

    constant: Fraction
    coefficients: Mapping[Expression, Fraction]

    def plus(self, other: "Affine") -> "Affine":
        """The sum."""
        sums = dict(self.coefficients)
        for symbol, coefficient in other.coefficients.items():
            sums[symbol] = sums.get(symbol, Fraction(0)) + coefficient
        return Affine(self.constant + other.constant, {symbol: c for symbol, c in sums.items() if c})

    def times(self, factor: Fraction) -> "Affine":
        """The product with a number."""
        scaled = {symbol: factor * c for symbol, c in self.coefficients.items() if factor}
        return Affine(factor * self.constant, scaled)


def affine_form(expression: Expression, excerpt: Excerpt) -> Affine:
    """The expression in affine form; raise ``ScenarioError`` where a number in it is none (division by zero, …)."""
    match expression:
        case Number(value):
            return _number(Fraction(repr(value)))
        case Negation(operand):
            return affine_form(operand, excerpt).times(Fraction(-1))
        case Sum(terms):
            total = _number(Fraction(0))
            for term in terms:
                total = total.plus(affine_form(term, excerpt))
            return total
        case Product(factors):
            return _product(expression, [affine_form(factor, excerpt) for factor in factors])
        case Reciprocal(operand):
            divisor = affine_form(operand, excerpt)
            if divisor.coefficients:
                return _symbol(expression)
            if not divisor.constant:
                raise excerpt.error(operand.at, "division by zero")
            return _number(1 / divisor.constant)
        case Power(base, exponent):
            return _power(expression, affine_form(base, excerpt), affine_form(exponent, excerpt), excerpt)
        case Call(function, arguments):
            forms = [affine_form(argument, excerpt) for argument in arguments]
            if any(form.coefficients for form in forms):
                return _symbol(expression)
            return _number(_value(FUNCTIONS[function].exact, [form.constant for form in forms], expression.at, excerpt))
    return _symbol(expression)


def with_folded_numbers(expression: Expression, excerpt: Excerpt) -> Expression:
    """The expression with each part that has one value replaced by the nearest double, and without terms of zero.

    Raises ``ScenarioError`` where such a part has no value, or none of double precision.
    """
    if is_number(expression):
        value = to_double(affine_form(expression, excerpt).constant, expression.at, excerpt)
        number = Number(abs(value), at=expression.at)
        return Negation(number, at=expression.at) if value < 0 else number
    folded = with_parts(expression, tuple(with_folded_numbers(part, excerpt) for part in parts_of(expression)))
    if isinstance(folded, Sum):
        terms = tuple(term for term in folded.terms if term != Number(0.0))
        return terms[0] if len(terms) == 1 else Sum(terms, at=folded.at)
    if isinstance(folded, Negation) and isinstance(folded.operand, Negation):
        return folded.operand.operand
    return folded


def to_double(value: Fraction, at: int, excerpt: Excerpt) -> float:
    """Nearest double; raise ``ScenarioError`` if that is infinite, or zero where ``value`` is not."""
    try:
        return nearest_double(value)
    except NoNumberError as error:
        raise excerpt.error(at, str(error)) from None


def _number(value: Fraction) -> Affine:
    return Affine(value, {})


def _symbol(expression: Expression) -> Affine:
    return Affine(Fraction(0), {expression: Fraction(1)})


def _product(product: Product, forms: list[Affine]) -> Affine:
    constant = Fraction(1)
    for form in forms:
        if not form.coefficients:
            constant *= form.constant
    varying = [(form, factor) for form, factor in zip(forms, product.factors, strict=True) if form.coefficients]
    if not varying:
        return _number(constant)
    if len(varying) == 1:
        return varying[0][0].times(constant)
    return _symbol(Product(tuple(factor for _, factor in varying), at=product.at)).times(constant)


def _power(power: Power, base: Affine, exponent: Affine, excerpt: Excerpt) -> Affine:
    if exponent.coefficients:
        return _symbol(power)
    if base.coefficients:
        if exponent.constant == 0:
            return _number(Fraction(1))
        return base if exponent.constant == 1 else _symbol(power)
    value, n = base.constant, exponent.constant
    if not value and n < 0:
        raise excerpt.error(power.base.at, "division by zero")
    if n.denominator != 1:
        if value < 0:
            raise excerpt.error(power.base.at, "a negative number has no power that is not whole")
        return _number(_value(of_doubles(math.pow), [value, n], power.at, excerpt))
    if bits(value) * abs(n) > MAX_BITS:
        raise excerpt.error(power.exponent.at, "the power has too many digits: expected one of moderate size")
    return _number(value ** int(n))


def _value(function: Exact, values: list[Fraction], at: int, excerpt: Excerpt) -> Fraction:
    """Value of a function of numbers."""
    try:
        return function(values)
    except NoNumberError as error:
        raise excerpt.error(at, str(error)) from None
