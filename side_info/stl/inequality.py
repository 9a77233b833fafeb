"""``expression >= 0`` as a Boolean structure of predicates, none of which has a kink in a state.

What follows from the definitions, with h an expression and h[K := a] the same with ``a`` in place of the kink K:

* ``abs(a)`` is ``max(a, -a)``.
* Where h grows with K, h[min(a, b)] >= 0 iff h[a] >= 0 and h[b] >= 0, and h[max(a, b)] >= 0 iff h[a] >= 0 or h[b] >= 0;
  where h falls, the other way round. So ``r - abs(affine) >= 0`` is a strip.
* Anywhere else h[max(a, b)] >= 0 iff (a - b >= 0 and h[a] >= 0) or (b - a >= 0 and h[b] >= 0).
* ``norm(v) <= r`` iff r >= 0 and sumsqr(v) <= r^2, which is smooth where the norm is not.

An expression that is not defined somewhere may have any value there. The structure then holds wherever some value makes
the inequality hold, or more (outer).
"""

import math
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import Final

from side_info.documents.source_location import Excerpt
from side_info.stl.affine import Affine, affine_form, to_double, with_folded_numbers
from side_info.stl.connectives import FALSE, TRUE, conjunction, disjunction
from side_info.stl.expression import (
    Call,
    Expression,
    Name,
    Negation,
    Number,
    Power,
    Product,
    Sum,
    names_of,
    nodes_of,
    parts_of,
    substituted,
    with_parts,
)
from side_info.stl.functions import FUNCTIONS, root
from side_info.stl.nnf import Normal
from side_info.stl.predicates import DiscPredicate, LinearPredicate, NonlinearPredicate, Predicate

#: Names, numbers and operators that may be looked at on the way to the cases of all inequalities of a scenario.
MAX_WORK: Final = 100_000

#: Different ones in one inequality; so deep do the cases nest.
MAX_KINKS: Final = 32


@dataclass(slots=True)
class Budget:
    """``left`` is how many parts of expressions may still be looked at."""

    left: int = MAX_WORK


@dataclass(frozen=True, slots=True)
class Atom(Normal):
    """A predicate that has no number yet, and no name."""

    predicate: Predicate


def not_negative(expression: Expression, excerpt: Excerpt, budget: Budget, *, strict: bool = False) -> Normal:
    """Structure of ``Atom`` that means ``expression >= 0``: exactly where it is defined.

    With ``strict`` it means the closure of ``expression > 0``, where what compares no state is compared exactly.
    Raises ``ScenarioError`` where a number is none, and for kinks that come to more cases than the budget has left.
    """
    with_folded_numbers(expression, excerpt)
    plain = _plain(expression)
    if len(set(filter(_is_kink, nodes_of(plain)))) > MAX_KINKS:
        raise excerpt.error(expression.at, f"more than {MAX_KINKS} kinks (abs, min, max): expected fewer")
    return _Cases(excerpt, expression.at, budget, strict).solve(plain)


def strip(form: Affine, lower: Fraction, upper: Fraction | None, at: int, excerpt: Excerpt) -> LinearPredicate:
    """``lower <= form <= upper`` with the constant moved into the bounds, first coefficient positive."""
    bounds = [math.inf if bound is None else to_double(bound - form.constant, at, excerpt) for bound in (lower, upper)]
    ordered = sorted((str(symbol), c) for symbol, c in form.coefficients.items())
    coefficients = {name: to_double(c, at, excerpt) for name, c in ordered}
    if next(iter(coefficients.values())) < 0:
        coefficients = {name: -c for name, c in coefficients.items()}
        bounds = [-bounds[1], -bounds[0]]
    return LinearPredicate("", coefficients, bounds[0] + 0.0, bounds[1] + 0.0)


def _plain(expression: Expression) -> Expression:
    """The same with ``hypot`` called ``norm``, and functions that are not needed for one argument resolved."""
    parts = tuple(map(_plain, parts_of(expression)))
    if not isinstance(expression, Call):
        return with_parts(expression, parts)
    function = "norm" if expression.function == "hypot" else expression.function
    if len(parts) == 1 and function in ("min", "max"):
        return parts[0]
    return Call("abs" if len(parts) == 1 and function == "norm" else function, parts, at=expression.at)


@dataclass(slots=True)
class _Cases:
    """Case distinctions of one inequality."""

    excerpt: Excerpt
    at: int
    budget: Budget
    strict: bool

    def solve(self, expression: Expression) -> Normal:
        self.budget.left -= sum(1 for _ in nodes_of(expression))
        if self.budget.left < 0:
            raise self.excerpt.error(self.at, "the kinks (abs, min, max) come to too many cases: expected fewer")
        form = affine_form(expression, self.excerpt)
        if not form.coefficients:
            return TRUE if form.constant > 0 or (form.constant == 0 and not self.strict) else FALSE
        if _is_affine(form):
            return Atom(strip(form, Fraction(0), None, self.at, self.excerpt))
        found = self._alone(expression, form)
        if found is None:
            found = self._split(expression, form)
        if found is None:
            return Atom(NonlinearPredicate("", with_folded_numbers(expression, self.excerpt)))
        return found

    def _alone(self, expression: Expression, form: Affine) -> Normal | None:
        """``abs``, ``norm`` or ``sumsqr`` of states against what does not depend on states."""
        varying = [symbol for symbol in form.coefficients if names_of(symbol)]
        call = varying[0] if len(varying) == 1 else None
        if not isinstance(call, Call) or call.function not in ("abs", "norm", "sumsqr"):
            return None
        sign = form.coefficients[call]
        if len(form.coefficients) > 1:
            return self._moving_norm(expression, call, sign) if call.function == "norm" else None
        limit = form.constant / -sign
        # call <= limit, or call >= limit, and the call is never negative
        if limit < 0 or (limit == 0 and sign > 0):
            return FALSE if sign < 0 else TRUE
        if limit == 0 and self.strict:
            return FALSE
        if limit == 0 and call.function != "abs":
            return conjunction(self.solve(Negation(Call("abs", (part,), at=call.at))) for part in call.arguments)
        return self._within(call, limit) if sign < 0 else self._outside(call, limit)

    def _within(self, call: Call, limit: Fraction) -> Normal | None:
        """``call <= limit``, which is positive."""
        forms = [affine_form(argument, self.excerpt) for argument in call.arguments]
        radius = root(limit) if call.function == "sumsqr" else limit
        if len(forms) == 1:
            return Atom(strip(forms[0], -radius, radius, self.at, self.excerpt)) if _is_affine(forms[0]) else None
        disc = self._disc(forms, radius)
        if disc is not None:
            return Atom(disc)
        return self.solve(Sum((self._double(limit**2), Negation(_squares(call))))) if call.function == "norm" else None

    def _outside(self, call: Call, limit: Fraction) -> Normal | None:
        """``call >= limit``, which is positive."""
        if call.function == "norm":
            return self.solve(Sum((_squares(call), Negation(self._double(limit**2)))))
        form = affine_form(call.arguments[0], self.excerpt)
        if len(call.arguments) > 1 or not _is_affine(form):
            return None
        radius = root(limit) if call.function == "sumsqr" else limit
        signed = (form, form.times(Fraction(-1)))
        return disjunction(Atom(strip(side, radius, None, self.at, self.excerpt)) for side in signed)

    def _moving_norm(self, expression: Expression, norm: Call, sign: Fraction) -> Normal:
        """``sign * norm + rest >= 0`` with a rest that depends on ``t``, ``k`` or the last state."""
        rest = substituted(expression, norm, Number(0.0))
        scaled = _squares(norm) if abs(sign) == 1 else Product((self._double(sign**2), _squares(norm)))
        squares = Sum((Power(rest, Number(2.0)), Negation(scaled)))
        if sign < 0:
            return conjunction((self.solve(rest), self.solve(squares)))
        return disjunction((self.solve(rest), self.solve(Negation(squares))))

    def _disc(self, forms: list[Affine], radius: Fraction) -> DiscPredicate | None:
        """The disc of two shifted states within ``radius``; None if the forms are anything else."""
        scales = {abs(c) for form in forms for c in form.coefficients.values()}
        states = [symbol.name for form in forms for symbol in form.coefficients if isinstance(symbol, Name)]
        if not all(map(_is_affine, forms)) or len(forms) != 2 or len(states) != 2 or len(set(states)) != 2:
            return None
        if len(scales) != 1:
            return None
        center = {
            state: to_double(-form.constant / next(iter(form.coefficients.values())), self.at, self.excerpt)
            for state, form in zip(states, forms, strict=True)
        }
        return DiscPredicate("", center, to_double(radius / scales.pop(), self.at, self.excerpt))

    def _split(self, expression: Expression, form: Affine) -> Normal | None:
        """The first kink resolved; None if there is none."""
        for symbol, sign in form.coefficients.items():
            others = (other for other in form.coefficients if other is not symbol)
            if _is_kink(symbol) and not any(node == symbol for other in others for node in nodes_of(other)):
                assert isinstance(symbol, Call)
                cases = (self.solve(substituted(expression, symbol, part)) for part in _branches(symbol))
                return conjunction(cases) if (sign > 0) == (symbol.function == "min") else disjunction(cases)
        kink = next(filter(_is_kink, nodes_of(expression)), None)
        if kink is None:
            return None
        assert isinstance(kink, Call)
        return disjunction(self._case(expression, kink, part) for part in _branches(kink))

    def _case(self, expression: Expression, kink: Call, part: Expression) -> Normal:
        """The kink is ``part``, and the inequality holds."""
        others = [other for other in _branches(kink) if other is not part]
        differences: list[Expression]
        if kink.function == "min":
            differences = [Sum((other, Negation(part)), at=part.at) for other in others]
        elif kink.function == "max":
            differences = [Sum((part, Negation(other)), at=part.at) for other in others]
        else:
            differences = [part]
        # Where two branches of a kink are equal, either of them may be taken.
        here = replace(self, strict=False)
        return conjunction((*map(here.solve, differences), self.solve(substituted(expression, kink, part))))

    def _double(self, value: Fraction) -> Number:
        return Number(to_double(value, self.at, self.excerpt), at=self.at)


def _is_affine(form: Affine) -> bool:
    return bool(form.coefficients) and all(isinstance(symbol, Name) for symbol in form.coefficients)


def _is_kink(expression: Expression) -> bool:
    return isinstance(expression, Call) and not FUNCTIONS[expression.function].smooth and bool(names_of(expression))


def _branches(kink: Call) -> tuple[Expression, ...]:
    """Expressions one of which the kink is equal to."""
    if kink.function == "abs":
        (argument,) = kink.arguments
        return argument, Negation(argument, at=argument.at)
    return tuple(dict.fromkeys(kink.arguments))


def _squares(norm: Call) -> Call:
    return Call("sumsqr", norm.arguments, at=norm.at)
