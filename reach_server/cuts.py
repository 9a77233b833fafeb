"""Predicates as cuts: the sets of a batch of branches, each cut by the predicates that its branch asks for."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from reach_server.factor_sets import FactorSet
from reach_server.predicates import Context, Literals, Strips
from reach_server.sets import strips, support
from reach_server.sets.arrays import Array

CutMethod = Literal["zonotope", "constrained", "frobenius"]
#: (literal, rows (K,)) to what its predicate refers to at those rows.
Contexts = Callable[[int, NDArray[np.intp]], Context]


@dataclass(frozen=True, slots=True, eq=False)
class CutSets:
    """Sets (R) after their cuts; where a literal left certainly nothing, and where it acted, (R, L)."""

    sets: FactorSet
    empty: NDArray[np.bool_]
    acted: NDArray[np.bool_]


def cut_sets(
    sets: FactorSet,
    asked: NDArray[np.bool_],
    literals: Literals,
    contexts: Contexts,
    method: CutMethod,
    n: int,
    plane: tuple[int, int] | None,
) -> CutSets:
    """Cut sets (R) by the literals that are asked for, (R, L), over their first ``n`` coordinates: outer bounds.

    What leaves certainly nothing is not applied; the caller drops such a branch.
    """
    empty, acted = np.zeros_like(asked), np.zeros_like(asked)
    strips_acted = np.zeros(len(asked), dtype=np.intp)
    used = np.flatnonzero(asked.any(axis=0))
    found: list[tuple[int, Strips]] = []
    # Cuts do not commute: where several act, a second pass lets the first ones profit from the later ones.
    for repeated in range(2 if method == "zonotope" else 1):
        if repeated and not (strips_acted > 1).any():
            break
        for place, literal in enumerate(used.tolist()):
            if repeated:
                bounds = found[place][1]
            else:
                rows = np.flatnonzero(asked[:, literal])
                bounds, nothing = strips_of(sets, rows, literal, literals, contexts, n)
                empty[rows, literal] |= nothing
                found.append((literal, bounds))
            for c in range(bounds.lower.shape[-1]):
                on = asked[:, literal] & ~empty[:, literal]
                if repeated:
                    on &= strips_acted > 1
                sets, missed, cut = _cut(sets, bounds, c, on, method, n, plane)
                empty[:, literal] |= missed
                acted[:, literal] |= cut
                if not repeated:
                    strips_acted += cut
    if method == "constrained" and sets.matrix.shape[1]:
        infeasible = support.emptiness_certificate(sets.matrix, sets.offset)
        empty |= infeasible[:, None] & acted
    return CutSets(sets, empty, acted)


def strips_of(
    sets: FactorSet, rows: NDArray[np.intp], literal: int, literals: Literals, contexts: Contexts, n: int
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


def _cut(
    sets: FactorSet,
    bounds: Strips,
    c: int,
    on: NDArray[np.bool_],
    method: CutMethod,
    n: int,
    plane: tuple[int, int] | None,
) -> tuple[FactorSet, NDArray[np.bool_], NDArray[np.bool_]]:
    """Sets cut by one strip where it is ``on``, where that left nothing, and where it acted, (R,)."""
    normal = np.zeros((*bounds.normal.shape[:-2], sets.center.shape[1]))
    normal[..., :n] = bounds.normal[..., c, :]
    lower = np.where(on, bounds.lower[:, c], -np.inf)
    upper = np.where(on, bounds.upper[:, c], np.inf)
    if method == "constrained":
        return _constrain(sets, normal, lower, upper)
    _, _, cut, missed = strips.strip_bounds(sets.center, sets.generators, normal, lower, upper)
    rows = np.flatnonzero(on if method == "frobenius" else cut)
    if not len(rows):
        return sets, missed, cut
    center = sets.center.copy()
    generators = np.concatenate([sets.generators, np.zeros((*center.shape, 1))], axis=2)
    matrix = np.concatenate([sets.matrix, np.zeros((*sets.matrix.shape[:2], 1))], axis=2)
    center[rows], generators[rows], missed[rows] = strips.intersect_strip(
        sets.center[rows], sets.generators[rows], normal[rows] if normal.ndim == 2 else normal, lower[rows],
        upper[rows], method="frobenius" if method == "frobenius" else "tight", plane=plane,
    )  # fmt: skip
    return FactorSet(center, generators, matrix, sets.offset), missed, cut


def _constrain(
    sets: FactorSet, normal: Array, lower: Array, upper: Array
) -> tuple[FactorSet, NDArray[np.bool_], NDArray[np.bool_]]:
    """Algorithm 3: one factor and one row more where the strip cuts, a zero row elsewhere."""
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
        FactorSet(
            sets.center,
            np.concatenate([sets.generators, np.zeros((count, z, 1))], axis=2),
            np.concatenate([matrix, row[:, None]], axis=1),
            np.concatenate([sets.offset, right[:, None]], axis=1),
        ),
        missed,
        cuts,
    )
