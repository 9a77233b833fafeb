"""Predicates ``h >= 0`` with h affine in the state, its coefficients given by the context.

For any point p, ``h(x) = h(p) + J (x - p)``, where h(p) and J depend on the context alone. So they are enclosed once
for all steps of a horizon (``ContextCache``), with p the middle of the last received state. With a the midpoint of J,
for true states x of the zonotope ``<c, G>``,

    h(x) <= h(p) + a·(c - p) + |J - a| (|c - p| + |G|₁) + a·(x - c) ,

which is used as in ``nonlinear``.
"""

from dataclasses import dataclass

import numpy as np

from reach_server.numeric.rounding import EPS
from reach_server.numeric.types import BoolArray, FloatArray
from reach_server.predicates.expansion import Above
from reach_server.predicates.halfspace import verdict_of
from reach_server.predicates.interface import Context, StateUncertainty, Strips, Verdict
from reach_server.predicates.interval_ad.enclosure import TaylorEnclosure
from reach_server.predicates.nonlinear import NonlinearEnclosure
from reach_server.predicates.remainders import middle
from side_info.stl.expression import Expression, Name, Negation, Product, Sum, names_of


@dataclass(frozen=True, slots=True, eq=False)
class AffineEnclosure(NonlinearEnclosure):
    """The predicate that a ``function`` that is affine in the states, and defined everywhere, is not negative."""

    def verdict(self, center: FloatArray, generators: FloatArray, context: Context) -> Verdict:
        """See ``PredicateEnclosure``: by bounds of h over the set."""
        with np.errstate(all="ignore"):
            moved = self._above(center, generators, context, self.uncertainty.still(), 1.0)
            still = self._above(center, generators, context, None, -1.0)
            return verdict_of(still.greatest <= 0, moved.negative)

    def strips(self, center: FloatArray, generators: FloatArray, context: Context) -> tuple[Strips, BoolArray]:
        """See ``PredicateEnclosure``: normal (R, 1, n), a half-space from below."""
        coordinates = list(self.function.coordinates)
        with np.errstate(all="ignore"):
            above = self._above(center, generators, context, self.uncertainty, 1.0)
            height = (above.normal * center[:, coordinates]).sum(axis=1)
            enlarged = np.abs(above.normal @ self.uncertainty.generators[coordinates]).sum(axis=1)
            rounding = _rounding(len(coordinates), self.uncertainty.generators.shape[1])
            level = height - above.top - enlarged - rounding * (above.size + enlarged)
        wide = np.zeros((len(center), 1, self.n))
        wide[:, 0, coordinates] = above.normal
        lower = np.where(np.isfinite(level), level, -np.inf)[:, None]
        return Strips(wide, lower, np.full_like(lower, np.inf)), above.negative

    def _above(
        self,
        center: FloatArray,
        generators: FloatArray,
        context: Context,
        uncertainty: StateUncertainty | None,
        sign: float,
    ) -> Above:
        """A linear upper bound of ``sign`` h on the true states of the sets."""
        coordinates = list(self.function.coordinates)
        middle_of, columns = center[:, coordinates], generators[:, coordinates]
        if uncertainty is not None:
            more = uncertainty.generators[coordinates]
            columns = np.concatenate([columns, np.broadcast_to(more, (len(center), *more.shape))], axis=2)
        point, enclosure = self._coefficients(context, len(center), None if uncertainty is None else uncertainty.margin)
        enclosure = enclosure if sign > 0 else -enclosure
        normal, uncertain = middle(enclosure.gradient)
        half = np.abs(columns).sum(axis=2)
        far = np.abs(middle_of - point) + half
        value, doubt = enclosure.value[1], (uncertain * far).sum(axis=1)
        reached = np.abs((normal[:, None] @ columns)[:, 0]).sum(axis=1)
        size = np.abs(value) + doubt + (np.abs(normal) * (np.abs(middle_of) + np.abs(point) + half)).sum(axis=1)
        margin = _rounding(len(coordinates), columns.shape[2]) * size
        top = value + (normal * (middle_of - point)).sum(axis=1) + doubt + margin
        known = enclosure.smooth & np.isfinite(top)
        normal, top = np.where(known[:, None], normal, 0.0), np.where(known, top, np.inf)
        greatest = np.where(known, top + reached + margin, np.inf)
        return Above(normal, top, greatest, np.where(known, size, 0.0), np.zeros(len(center)))

    def _coefficients(self, context: Context, rows: int, margin: float | None) -> tuple[FloatArray, TaylorEnclosure]:
        """A point (R, s), and h there with its gradient, for the rows of a context."""
        if context.cache is None or context.index is None:
            return self._evaluated(context, rows, margin)
        key = self, margin
        if key not in context.cache.found:
            whole = context.cache.context
            context.cache.found[key] = self._evaluated(whole, len(whole.t), margin)
        point, enclosure = context.cache.found[key]
        return point[context.index], enclosure[context.index]

    def _evaluated(self, context: Context, rows: int, margin: float | None) -> tuple[FloatArray, TaylorEnclosure]:
        coordinates = list(self.function.coordinates)
        point = context.last_lower[:, coordinates] / 2 + context.last_upper[:, coordinates] / 2
        point = np.where(np.isfinite(point), point, 0.0)
        given = self.function.given(context, rows, margin)
        return point, self.function.enclosure(point, point, given, curved=False)


def _rounding(states: int, columns: int) -> float:
    """What sums and products over this many states and generators lose, relative to the sum of their absolute terms:
    one EPS for each of them, with room to spare."""
    return (16 + 4 * states + columns) * EPS


def affine_in_states(expression: Expression) -> bool:
    """Whether an expression is affine in the states as it is written; a Hessian of zero would not tell of jumps."""
    match expression:
        case Name():
            return True
        case Sum(terms):
            return all(map(affine_in_states, terms))
        case Negation(operand):
            return affine_in_states(operand)
        case Product(factors):
            return sum(bool(names_of(f)) for f in factors) <= 1 and all(map(affine_in_states, factors))
    return not names_of(expression)
