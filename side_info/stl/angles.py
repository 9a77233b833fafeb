"""Angles that wrap: where a predicate may speak about one without telling apart what is the same."""

from collections.abc import Set

from side_info.documents.source_location import Excerpt
from side_info.stl.affine import affine_form
from side_info.stl.expression import Call, Expression, Last, Name, parts_of
from side_info.stl.functions import FUNCTIONS
from side_info.stl.predicates import NonlinearPredicate, Predicate


def misused_angle(predicate: Predicate, angles: Set[str]) -> str | None:
    """A state of ``angles`` that may not be moved by 2π without changing the predicate, or None.

    Such a move changes nothing inside a periodic function (``sin``, ``cos``, ``tan``) of an expression that has the
    angle a whole number of times (also of its ``last`` value, which wraps on its own).
    """
    if isinstance(predicate, NonlinearPredicate):
        return _misused(predicate.expression, angles)
    return next((state for state in predicate.states if state in angles), None)


def _misused(expression: Expression, angles: Set[str]) -> str | None:
    if isinstance(expression, Name | Last):
        return expression.name if expression.name in angles else None
    parts = parts_of(expression)
    if isinstance(expression, Call) and FUNCTIONS[expression.function].periodic:
        # What stands in a predicate has been read before: there is no place left to show.
        form = affine_form(expression.arguments[0], Excerpt.alone("", "predicate"))
        whole = {s for s, c in form.coefficients.items() if isinstance(s, Name | Last) and c.denominator == 1}
        parts = tuple(symbol for symbol in form.coefficients if symbol not in whole)
    return next((found for part in parts if (found := _misused(part, angles)) is not None), None)
