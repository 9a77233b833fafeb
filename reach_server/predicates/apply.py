"""Cuts of the sets of a batch of branches by the predicates that each branch asks for."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from reach_server.predicates import Context, Literals, Strips
from reach_server.predicates.cut_kinds import CUT_KINDS, CutKind, CutMethod
from reach_server.sets import halfspace as strips
from reach_server.sets import support
from reach_server.sets.kernels.strip import ACTED, MISSED
from reach_server.sets.raw import RawSets

#: (literal, rows (K,)) to what its predicate refers to at those rows.
Contexts = Callable[[int, NDArray[np.intp]], Context]


class StepContexts(Protocol):
    """What predicates refer to."""

    def __call__(self, k: int, track: NDArray[np.intp]) -> Contexts:
        """At step ``k``, by literal and rows of branches of the tracks (R,)."""


@dataclass(frozen=True, slots=True, eq=False)
class CutSets:
    """Sets (R) after their cuts; where a literal certainly left nothing, and where it cut, (R, L)."""

    sets: RawSets
    empty: NDArray[np.bool_]
    active: NDArray[np.bool_]


def cut_sets(
    sets: RawSets,
    asked: NDArray[np.bool_],
    literals: Literals,
    contexts: Contexts,
    method: CutMethod,
    n: int,
    plane: tuple[int, int] | None,
) -> CutSets:
    """Cut sets (R) by the literals that are asked for, (R, L), over their first ``n`` coordinates: outer bounds.

    A cut that certainly leaves nothing is not applied; the caller drops such a branch.
    """
    kind = CUT_KINDS[method]
    if kind.adds_constraints:
        return _constrained(sets, asked, literals, contexts, n)
    cut = _Zonotopes(sets, np.zeros_like(asked), np.zeros_like(asked), kind, plane)
    used = np.flatnonzero(asked.any(axis=0)).tolist()
    fixed = [_Asked(i, literals.fixed_strips(i), asked[:, i]) for i in used if literals.fixed(i)]
    cut = cut.narrowed(fixed)
    moving = []
    # The strips of these depend on the set: the smaller it is, the more they cut.
    for literal in used:
        if not literals.fixed(literal):
            rows = np.flatnonzero(asked[:, literal])
            bounds, nothing = strips_of(cut.sets, rows, literal, literals, contexts, n)
            cut.empty[rows, literal] |= nothing
            moving.append(_Asked(literal, bounds, asked[:, literal]))
    cut = cut.narrowed(moving)
    if kind.passes > 1 and fixed and moving:
        # Cuts do not commute: the first ones may profit from the later ones.
        again = (cut.active.sum(axis=1) > 1) & ~cut.empty.any(axis=1)
        if again.any():
            cut = cut.narrowed([_Asked(f.literal, f.bounds, f.rows & again) for f in fixed + moving])
    return CutSets(cut.sets, cut.empty, cut.active)


@dataclass(frozen=True, slots=True, eq=False)
class _Asked:
    """A literal, its strips for all rows, and the rows (R,) that it is asked of."""

    literal: int
    bounds: Strips
    rows: NDArray[np.bool_]


@dataclass(frozen=True, slots=True, eq=False)
class _Zonotopes:
    """Zonotopes (R) between cuts; ``empty`` and ``active`` (R, L) as in ``CutSets``."""

    sets: RawSets
    empty: NDArray[np.bool_]
    active: NDArray[np.bool_]
    kind: CutKind
    plane: tuple[int, int] | None

    def narrowed(self, asked: Sequence[_Asked]) -> "_Zonotopes":
        """The zonotopes cut by the strips of some literals, all at once."""
        if not asked:
            return self
        found = strips.narrow(
            self.sets.center, self.sets.generators, _side_by_side([a.bounds.normal for a in asked], 2),
            _side_by_side([a.bounds.lower for a in asked], 1), _side_by_side([a.bounds.upper for a in asked], 1),
            _side_by_side([np.repeat(a.rows[:, None], a.bounds.lower.shape[-1], axis=1) for a in asked], 1),
            method="frobenius" if self.kind.keeps_larger_result else "tight", plane=self.plane,
        )  # fmt: skip
        owner = np.repeat([a.literal for a in asked], [a.bounds.lower.shape[-1] for a in asked])
        for c, literal in enumerate(owner.tolist()):
            self.active[:, literal] |= found.acted[:, c] & ACTED != 0
            self.empty[:, literal] |= found.acted[:, c] & MISSED != 0
        retained = int(found.used.max(initial=0))
        return replace(self, sets=RawSets.zonotope(found.center, found.generators[:, :, :retained]))


def _side_by_side(arrays: list[NDArray[Any]], own: int) -> NDArray[Any]:
    """Arrays (C, ...) or (R, C, ...) of ``own`` axes, joined along C."""
    if len(arrays) == 1:
        return arrays[0]
    batch = np.broadcast_shapes(*(a.shape[: a.ndim - own] for a in arrays))
    return np.concatenate([np.broadcast_to(a, batch + a.shape[a.ndim - own :]) for a in arrays], axis=len(batch))


def _constrained(sets: RawSets, asked: NDArray[np.bool_], literals: Literals, contexts: Contexts, n: int) -> CutSets:
    empty, active = np.zeros_like(asked), np.zeros_like(asked)
    for literal in np.flatnonzero(asked.any(axis=0)).tolist():
        rows = np.flatnonzero(asked[:, literal])
        bounds, nothing = strips_of(sets, rows, literal, literals, contexts, n)
        empty[rows, literal] |= nothing
        for c in range(bounds.lower.shape[-1]):
            on = asked[:, literal] & ~empty[:, literal]
            sets, missed, cut = _constrain(sets, bounds, c, on, n)
            empty[:, literal] |= missed
            active[:, literal] |= cut
    if sets.matrix.shape[1]:
        empty |= support.emptiness_certificate(sets.matrix, sets.offset)[:, None] & active
    return CutSets(sets, empty, active)


def strips_of(
    sets: RawSets, rows: NDArray[np.intp], literal: int, literals: Literals, contexts: Contexts, n: int
) -> tuple[Strips, NDArray[np.bool_]]:
    """Strips of a literal for all rows (the normals (C, n) or (R, C, n), bounds (R, C)), infinite where it is not
    asked for; and at which of ``rows`` no state satisfies it."""
    everywhere = len(rows) == len(sets.center)
    chosen = slice(None) if everywhere else rows
    strip, nothing = literals.strips(
        literal, sets.center[chosen, :n], sets.generators[chosen, :n], contexts(literal, rows)
    )
    count, total = strip.lower.shape[-1], len(sets.center)
    lower, upper = np.full((total, count), -np.inf), np.full((total, count), np.inf)
    lower[chosen], upper[chosen] = strip.lower, strip.upper
    normal = strip.normal
    if normal.ndim == 3 and not everywhere:
        normal = np.zeros((total, count, n))
        normal[chosen] = strip.normal
    return Strips(normal, lower, upper), nothing


def _constrain(
    sets: RawSets, bounds: Strips, c: int, on: NDArray[np.bool_], n: int
) -> tuple[RawSets, NDArray[np.bool_], NDArray[np.bool_]]:
    """Algorithm 3: one factor and one row more where a strip that is ``on`` cuts, a zero row elsewhere; where it left
    nothing, and where it acted, (R,)."""
    normal = np.zeros((*bounds.normal.shape[:-2], sets.center.shape[1]))
    normal[..., :n] = bounds.normal[..., c, :]
    lower = np.where(on, bounds.lower[:, c], -np.inf)
    upper = np.where(on, bounds.upper[:, c], np.inf)
    q, r, cuts, missed = strips.strip_bounds(sets.center, sets.generators, normal, lower, upper)
    if not cuts.any():
        return sets, missed, cuts
    count, z, _ = sets.generators.shape
    wide = np.broadcast_to(normal, sets.center.shape)
    heights = (wide[:, None] @ sets.generators)[:, 0]
    row = np.where(cuts[:, None], np.concatenate([heights, -r[:, None]], axis=1), 0.0)
    right = np.where(cuts, q - (wide * sets.center).sum(axis=1), 0.0)
    matrix = np.concatenate([sets.matrix, np.zeros((count, sets.matrix.shape[1], 1))], axis=2)
    return (
        RawSets(
            sets.center,
            np.concatenate([sets.generators, np.zeros((count, z, 1))], axis=2),
            np.concatenate([matrix, row[:, None]], axis=1),
            np.concatenate([sets.offset, right[:, None]], axis=1),
        ),
        missed,
        cuts,
    )
