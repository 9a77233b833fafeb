"""Formulas and predicates in normal form, from text."""

import math

from side_info import (
    Declarations,
    Formula,
    Predicate,
)
from side_info.documents.source_location import Excerpt
from side_info.stl.nnf import Conjunction, Literal, Normal
from side_info.stl.normal_form import NormalForms

INFINITY = math.inf
DECLARED = Declarations(("x1", "x2", "x3"), (), {"c": 0.307})


def normal(text: str, *, positive: bool = True) -> tuple[Normal, tuple[Predicate, ...]]:
    forms = NormalForms()
    formula = Formula.parse(text, DECLARED, "test")
    return forms.of(formula, Excerpt.alone(text, "test"), holds=positive), forms.predicates()


def predicates(text: str) -> tuple[Predicate, ...]:
    """Predicates of a comparison that is a conjunction of them."""
    form, found = normal(text)
    expected = tuple(map(Literal, range(len(found))))
    assert form == (Conjunction(expected) if len(found) > 1 else expected[0])
    return found
