"""What one step of the engine returns, and how sets become the constant-size figures that are published."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fleet_bus.messages import Cut, EventKind, Label
from reach_server.predicates import CutTable
from reach_server.sets import planar, reduction, support
from reach_server.tube import FactorSet
from reach_server.windows import Floats, Ints

#: Directions in which an outline bounds its set.
OUTLINE = 12
#: Directions from which the area of a constrained set is bounded.
AREA_DIRECTIONS = 32
#: Generators of a published set beyond one per state.
EXTRA_GENERATORS = 2


@dataclass(frozen=True, slots=True)
class EngineEvent:
    """Something that happened to one vehicle in one step."""

    kind: EventKind
    vehicle: str
    t: int
    message: str
    details: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, eq=False)
class Tubes:
    """Tubes of B vehicles: ``steps`` holds the sets of steps 1 to N, ``free`` those without side information.

    ``area`` and ``area_free`` (B, N), ``outline`` (B, N, K, 2) and ``hull`` (B, N, 2, n) as in ``Figures``;
    ``labels``, ``cuts`` and ``notes`` one entry a vehicle; ``waiting`` says why other vehicles of the batch got no
    tube.
    """

    vehicles: tuple[str, ...]
    epoch: NDArray[np.uint64]
    seq: NDArray[np.uint64]
    t: Ints
    times: Ints
    steps: tuple[FactorSet, ...]
    free: tuple[FactorSet, ...]
    area: Floats
    area_free: Floats
    outline: Floats
    hull: Floats
    labels: tuple[Label, ...]
    method: str
    cuts: tuple[tuple[Cut, ...], ...]
    notes: tuple[tuple[str, ...], ...]
    events: tuple[EngineEvent, ...]
    waiting: dict[str, str]


@dataclass(frozen=True, slots=True, eq=False)
class Figures:
    """What is published about the sets of one step: ``area`` (B,), ``outline`` (B, K, 2) and ``hull`` (B, 2, n), both
    relative to the centers."""

    area: Floats
    outline: Floats
    hull: Floats


def figures(sets: FactorSet, acting: NDArray[np.bool_], table: CutTable, plane: tuple[int, int]) -> Figures:
    """Area, outline and box around sets (B), cut once more by the predicates that act on them, (B, C).

    Zonotopes: the area is exact (of the set, where a predicate on the position acts: of its intersection with it), the
    outline and the box are outer bounds. Constrained sets: all three are outer bounds, certified by duality. Each
    side of the outline, and the box, is moved outwards by 1e-6 of the size of the set, more than rounding to float32
    can take back.
    """
    size = np.abs(sets.generators).sum(axis=-1)
    if sets.matrix.shape[1]:
        return _constrained_figures(sets, plane)
    planar_generators = sets.generators[:, plane, :]
    zero = np.zeros((len(size), 2))
    area = planar.zonotope_area(planar_generators)
    heights = support.zonotope_support(zero, planar_generators, planar.directions(OUTLINE))
    hull = np.stack([-size, size], axis=1)
    rows, vertices = _clipped(sets, acting, table, plane)
    if len(rows):
        area[rows] = np.clip(planar.polygon_area(vertices), 0.0, area[rows])
        heights[rows] = np.minimum(heights[rows], (vertices @ planar.directions(OUTLINE).T).max(axis=1))
        for place, i in enumerate(plane):
            hull[rows, 0, i] = np.maximum(hull[rows, 0, i], vertices[..., place].min(axis=1))
            hull[rows, 1, i] = np.minimum(hull[rows, 1, i], vertices[..., place].max(axis=1))
    margin = 1e-6 * size
    widened = heights + margin[:, plane].sum(axis=1)[:, None]
    hull = hull + np.stack([-margin, margin], axis=1)
    return Figures(area, planar.outer_polygon(widened), hull)


def _clipped(
    sets: FactorSet, acting: NDArray[np.bool_], table: CutTable, plane: tuple[int, int]
) -> tuple[NDArray[np.intp], Floats]:
    """Rows on which predicates about the position act, and the polygons (R, V, 2) that are left of them."""
    others = [i for i in range(table.normal.shape[1]) if i not in plane]
    about_position = ~table.normal[:, others].any(axis=1)
    rows = np.flatnonzero((acting & about_position).any(axis=1))
    if not len(rows):
        return rows, np.zeros((0, 0, 2))
    vertices = planar.zonotope_polygon(np.zeros((len(rows), 2)), sets.generators[rows][:, plane, :])
    for c in np.flatnonzero(acting[rows].any(axis=0) & about_position):
        normal = table.normal[c, list(plane)]
        offset = sets.center[rows][:, plane] @ normal
        on = acting[rows, c]
        vertices = planar.clip(vertices, normal, np.where(on, table.upper[c] - offset, np.inf))
        vertices = planar.clip(vertices, -normal, np.where(on, offset - table.lower[c], np.inf))
    return rows, vertices


def _constrained_figures(sets: FactorSet, plane: tuple[int, int]) -> Figures:
    n = sets.center.shape[1]
    size = np.abs(sets.generators).sum(axis=-1)
    planar_generators = sets.generators[:, plane, :]
    unit = np.concatenate([np.eye(n), -np.eye(n)])
    bounds = support.constrained_support(np.zeros_like(sets.center), sets.generators, sets.matrix, sets.offset, unit)
    hull = np.stack([np.maximum(-bounds[:, n:], -size), np.minimum(bounds[:, :n], size)], axis=1)
    zero = np.zeros((len(size), 2))
    heights = support.constrained_support(
        zero, planar_generators, sets.matrix, sets.offset, planar.directions(AREA_DIRECTIONS)
    )
    area = np.clip(planar.polygon_area(planar.outer_polygon(heights)), 0.0, planar.zonotope_area(planar_generators))
    outline = support.constrained_support(zero, planar_generators, sets.matrix, sets.offset, planar.directions(OUTLINE))
    margin = 1e-6 * size
    widened = outline + margin[:, plane].sum(axis=1)[:, None]
    return Figures(area, planar.outer_polygon(widened), hull + np.stack([-margin, margin], axis=1))


def enclosing(sets: FactorSet) -> Floats:
    """Generators (B, n, n + 2) of zonotopes around the sets whose last n columns are diagonal: outer."""
    n = sets.center.shape[1]
    count = n + EXTRA_GENERATORS
    reduced = reduction.boxed(sets.generators, count)
    missing = count - reduced.shape[-1]
    return np.concatenate([np.zeros((*reduced.shape[:-1], missing)), reduced], axis=-1) if missing > 0 else reduced
