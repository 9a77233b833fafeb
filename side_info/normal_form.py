"""A comparison to its normal form: the exact set of states that satisfy it, or a refusal by name.

Expressions are brought into ``constant + sum of coefficient * symbol`` in rational arithmetic, where a symbol
is a state or a call (``abs``, ``norm``, ``sumsqr``). Numbers mean the decimals that were written; only the
finished bounds and coefficients are rounded, to the nearest double.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction
from typing import Final

from side_info.expression import Call, Expression, Name, Negation, Number, Power, Product, Reciprocal, Sum
from side_info.formula import Comparison
from side_info.places import Excerpt
from side_info.predicates import DiscPredicate, LinearPredicate, Predicate

# A power of a power of a power would fill the memory with digits.
_MAX_BITS: Final = 20_000

_SQUARE_HINT: Final = "; write a disc as sumsqr(x - a, y - b) <= r^2"


@dataclass(frozen=True, slots=True)
class _Affine:
    """``constant + sum of coefficients[s] * s``, no coefficient zero."""

    constant: Fraction
    coefficients: Mapping[str | Call, Fraction]

    def plus(self, other: "_Affine") -> "_Affine":
        sums = dict(self.coefficients)
        for symbol, coefficient in other.coefficients.items():
            sums[symbol] = sums.get(symbol, Fraction(0)) + coefficient
        return _Affine(self.constant + other.constant, {symbol: c for symbol, c in sums.items() if c})

    def times(self, factor: Fraction) -> "_Affine":
        scaled = {symbol: factor * c for symbol, c in self.coefficients.items() if factor}
        return _Affine(factor * self.constant, scaled)


def normal_form(comparison: Comparison, excerpt: Excerpt) -> tuple[Predicate, ...]:
    """Predicates that together mean the comparison: exactly, but for ``<`` taken as ``<=`` (outer).

    ``a <= affine <= b`` and ``abs(affine) <= r`` give one strip, ``norm(…) <= r`` and ``sumsqr(…) <= r^2``
    over two states one disc. Each predicate is named by its text.
    Raises ``ScenarioError`` at the place of what has no normal form or can never hold.
    """
    parts: list[Predicate] = []
    for left, sign, right in zip(comparison.operands, comparison.operators, comparison.operands[1:], strict=False):
        low, high = (left, right) if sign[0] == "<" else (right, left)
        difference = _affine(high, excerpt).plus(_affine(low, excerpt).times(Fraction(-1)))
        parts.append(_not_negative(difference, f"{left} {sign} {right}", left.at, excerpt))
    strip = _merged(parts, comparison, excerpt)
    return tuple(parts) if strip is None else (strip,)


def _merged(parts: list[Predicate], comparison: Comparison, excerpt: Excerpt) -> LinearPredicate | None:
    """One strip that means all of the parts, if they are parallel."""
    linear = [part for part in parts if isinstance(part, LinearPredicate)]
    if len(linear) < max(2, len(parts)) or any(p.coefficients != linear[0].coefficients for p in linear):
        return None
    lower, upper = max(part.lower for part in linear), min(part.upper for part in linear)
    if lower > upper:
        raise excerpt.error(comparison.at, f"can never hold: {lower:g} > {upper:g}")
    return LinearPredicate(str(comparison), linear[0].coefficients, lower, upper)


def _affine(expression: Expression, excerpt: Excerpt) -> _Affine:
    match expression:
        case Number(value):
            return _Affine(Fraction(repr(value)), {})
        case Name(name):
            return _Affine(Fraction(0), {name: Fraction(1)})
        case Negation(operand):
            return _affine(operand, excerpt).times(Fraction(-1))
        case Sum(terms):
            total = _Affine(Fraction(0), {})
            for term in terms:
                total = total.plus(_affine(term, excerpt))
            return total
        case Product(factors):
            product = _Affine(Fraction(1), {})
            for factor in factors:
                product = _product(product, _affine(factor, excerpt), factor, excerpt)
            return product
        case Reciprocal(operand):
            divisor = _constant(operand, "a divisor", excerpt)
            if not divisor:
                raise excerpt.error(operand.at, "division by zero")
            return _Affine(1 / divisor, {})
        case Power(base, exponent):
            return _power(base, exponent, excerpt)
        case Call("abs", (argument,)):
            inner = _affine(argument, excerpt)
            if not inner.coefficients:
                return _Affine(abs(inner.constant), {})
            return _Affine(Fraction(0), {expression: Fraction(1)})
        case Call():
            return _Affine(Fraction(0), {expression: Fraction(1)})
    raise TypeError(f"{type(expression).__name__} is no expression of this version")


def _product(left: _Affine, right: _Affine, factor: Expression, excerpt: Excerpt) -> _Affine:
    if not right.coefficients:
        return left.times(right.constant)
    if not left.coefficients:
        return right.times(left.constant)
    names = ", ".join(str(symbol) for symbol in (*left.coefficients, *right.coefficients))
    raise excerpt.error(factor.at, f"a product of states ({names:.60}) is not supported in this version{_SQUARE_HINT}")


def _power(base: Expression, exponent: Expression, excerpt: Excerpt) -> _Affine:
    power = _constant(exponent, "an exponent", excerpt)
    affine = _affine(base, excerpt)
    if affine.coefficients:
        if power == 1:
            return affine
        raise excerpt.error(
            base.at, f"a power of a state ({base!s:.60}) is not supported in this version{_SQUARE_HINT}"
        )
    value = affine.constant
    bits = max(value.numerator.bit_length(), value.denominator.bit_length())
    if power.denominator != 1 or bits * abs(power) > _MAX_BITS:
        raise excerpt.error(exponent.at, "an exponent must be a whole number, and the power of moderate size")
    if not value and power < 0:
        raise excerpt.error(base.at, "division by zero")
    return _Affine(value ** int(power), {})


def _constant(expression: Expression, what: str, excerpt: Excerpt) -> Fraction:
    affine = _affine(expression, excerpt)
    if affine.coefficients:
        raise excerpt.error(
            expression.at,
            f"{what} must be a number, {str(expression)[:60]!r} is not: not supported in this version",
        )
    return affine.constant


def _not_negative(form: _Affine, name: str, at: int, excerpt: Excerpt) -> Predicate:
    """Predicate that means ``form >= 0``."""
    calls = [symbol for symbol in form.coefficients if isinstance(symbol, Call)]
    if not form.coefficients:
        raise excerpt.error(at, f"{name:.60} compares no state: expected a state on one side")
    if not calls:
        return _linear(name, form, Fraction(0), None, at, excerpt)
    if len(form.coefficients) > 1:
        mixed = ", ".join(str(symbol) for symbol in form.coefficients)
        raise excerpt.error(at, f"{mixed:.80} together in one comparison are not supported in this version")
    call, coefficient = calls[0], form.coefficients[calls[0]]
    if coefficient > 0:
        raise excerpt.error(at, f"{call!s:.60} bounded from below means 'or', which is not supported in this version")
    limit = form.constant / -coefficient
    if limit < 0:
        raise excerpt.error(at, f"can never hold: {call!s:.60} is not negative")
    return _bounded_call(name, call, limit, at, excerpt)


def _bounded_call(name: str, call: Call, limit: Fraction, at: int, excerpt: Excerpt) -> Predicate:
    """Predicate that means ``call <= limit``."""
    arguments = [_affine(argument, excerpt) for argument in call.arguments]
    for form, argument in zip(arguments, call.arguments, strict=True):
        if not form.coefficients or any(isinstance(symbol, Call) for symbol in form.coefficients):
            raise excerpt.error(
                argument.at,
                f"{str(argument)[:60]!r} in {call.function} is not affine in the states: not supported in this version",
            )
    if len(arguments) == 1:
        if call.function == "sumsqr":
            limit = _root(limit)
        return _linear(name, arguments[0], -limit, limit, at, excerpt)
    scales = {abs(c) for form in arguments for c in form.coefficients.values()}
    states = [symbol for form in arguments for symbol in form.coefficients if isinstance(symbol, str)]
    if len(arguments) != 2 or len(states) != 2 or len(set(states)) != 2 or len(scales) != 1:
        raise excerpt.error(
            call.at,
            f"{call.function} of anything but two shifted states (a disc) is not supported in this version",
        )
    scale = scales.pop()
    radius = (_root(limit) if call.function == "sumsqr" else limit) / scale
    if not radius:
        raise excerpt.error(at, f"{name:.60} is a single point: expected a positive radius")
    center = {
        state: _double(-form.constant / form.coefficients[state], at, excerpt)
        for state, form in zip(states, arguments, strict=True)
    }
    return DiscPredicate(name, center, _double(radius, at, excerpt))


def _linear(
    name: str, form: _Affine, lower: Fraction, upper: Fraction | None, at: int, excerpt: Excerpt
) -> LinearPredicate:
    """``lower <= form <= upper`` with the constant moved into the bounds, first coefficient positive."""
    bounds = [math.inf if bound is None else _double(bound - form.constant, at, excerpt) for bound in (lower, upper)]
    ordered = sorted(form.coefficients.items(), key=lambda item: str(item[0]))
    coefficients = {str(symbol): _double(c, at, excerpt) for symbol, c in ordered}
    if next(iter(coefficients.values())) < 0:
        coefficients = {symbol: -c for symbol, c in coefficients.items()}
        bounds = [-bounds[1], -bounds[0]]
    return LinearPredicate(name, coefficients, bounds[0] + 0.0, bounds[1] + 0.0)


def _double(value: Fraction, at: int, excerpt: Excerpt) -> float:
    try:
        double = float(value)
    except OverflowError:
        double = math.inf
    if math.isinf(double) or (value and not double):
        raise excerpt.error(at, "a number leaves the range of double precision")
    return double


def _root(value: Fraction) -> Fraction:
    """Square root: exact if it is rational, else to more digits than a double has."""
    p, q = value.numerator, value.denominator
    shift = 0
    if math.isqrt(p) ** 2 != p or math.isqrt(q) ** 2 != q:
        # sqrt(p / q) = sqrt(p q 4^s) / (q 2^s), s large enough for more digits than a double has
        shift = max(0, 64 - (p * q).bit_length() // 2)
        p, q = p * q << 2 * shift, q * q << 2 * shift
    return Fraction(math.isqrt(p), math.isqrt(q))
