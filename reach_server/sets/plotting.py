"""Sets and tubes as Matplotlib artists: outlines in the plane, bands over time (needs the extra ``pictures``).

Nothing in the server imports this module.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.collections import FillBetweenPolyCollection, LineCollection
from matplotlib.colors import Colormap
from matplotlib.patches import Polygon
from numpy.typing import ArrayLike

from reach_server.numeric.checks import checked
from reach_server.numeric.types import FloatArray
from reach_server.sets import ConstrainedZonotope, SetError, Zonotope

AnySet = Zonotope | ConstrainedZonotope
#: One set per time: a sequence of sets of batch ``()``, or one batch ``(K,)``.
Sets = AnySet | Sequence[AnySet]


def outlines(sets: Sets, axes: tuple[int, int] = (0, 1)) -> list[FloatArray]:
    """Vertices (V, 2), counter-clockwise, of the projection of each set on two coordinates: exact.

    Repeated vertices are left out: a point has one, a segment two, an empty set none. A batch comes in the order of
    its places, the last axis fastest.
    """
    found = []
    for one in _each(sets):
        _check_axes(one, axes)
        if bool(one.is_empty()):
            found.append(np.zeros((0, 2)))
            continue
        planar = one.project(axes)
        vertices = planar.polygon()
        found.append(_distinct(vertices[np.isfinite(vertices).all(axis=-1)]))
    return found


def draw_sets(axis: Axes, sets: Sets, axes: tuple[int, int] = (0, 1), **style: Any) -> list[Polygon]:
    """Add the projection of each set on two coordinates to ``axis``, and return the patches; an empty set gets none.

    ``style`` goes to ``matplotlib.patches.Polygon``; by default filled, with an edge in the next colour
    of the cycle, so that points and segments are seen, too. A ``label`` is given to the first patch only.
    """
    if not style.keys() & {"color", "facecolor", "fc", "edgecolor", "ec"}:
        colour = axis._get_lines.get_next_color()  # type: ignore[attr-defined]
        style = {"facecolor": (colour, 0.3), "edgecolor": colour, **style}
    label = style.pop("label", None)
    patches: list[Polygon] = []
    for vertices in outlines(sets, axes):
        if not len(vertices):
            continue
        patch = Polygon(vertices, closed=True, **{"joinstyle": "round", **style})
        if label is not None and not patches:
            patch.set_label(label)
        axis.add_patch(patch)
        patches.append(patch)
    axis.autoscale_view()
    return patches


def draw_tube(
    axis: Axes, sets: Sets, axes: tuple[int, int] = (0, 1), colours: str | Colormap = "viridis", **style: Any
) -> list[Polygon]:
    """Add the outline of each step of a tube to ``axis``, coloured from the first step to the last; return the patches.

    Later steps lie behind earlier ones. An empty step gets no patch.
    """
    steps = list(_each(sets))
    shades = colormaps[colours] if isinstance(colours, str) else colours
    patches: list[Polygon] = []
    for k, one in enumerate(steps):
        shade = shades(k / max(len(steps) - 1, 1))
        patches += draw_sets(
            axis, one, axes,
            **{"facecolor": (*shade[:3], 0.25), "edgecolor": shade, "zorder": 1 + 1 / (2 + k), **style},
        )  # fmt: skip
    return patches


def draw_bands(
    axis: Axes, times: ArrayLike, sets: Sets, coordinate: int = 0, **style: Any
) -> tuple[FillBetweenPolyCollection, LineCollection]:
    """Add the range of one coordinate over ``times`` (K,) to ``axis``: bars at the times, and a pale band between them.

    Only the bars are bounds: about the motion between two times a tube says nothing. The bars end at the interval hull.
    An empty set leaves a gap. ``style`` goes to both artists; ``alpha`` to the band, ``label`` to the bars. Raises
    ``SetError`` for times that are not one per set, and for a coordinate that a set does not have.
    """
    moments = checked(times, "times", (None,))
    steps = list(_each(sets))
    if moments.shape != (len(steps),):
        raise SetError(f"times has shape {moments.shape}, expected ({len(steps)},): one per set")
    lower, upper = np.full(len(steps), np.nan), np.full(len(steps), np.nan)
    for k, one in enumerate(steps):
        if not -one.dimension <= coordinate < one.dimension:
            raise SetError(f"coordinate is {coordinate}, the set has {one.dimension}")
        if not bool(one.is_empty()):
            low, high = one.interval_hull()
            lower[k], upper[k] = low[coordinate], high[coordinate]
    if "color" not in style:
        style["color"] = axis._get_lines.get_next_color()  # type: ignore[attr-defined]
    alpha, label = style.pop("alpha", 0.25), style.pop("label", None)
    band = axis.fill_between(moments, lower, upper, alpha=alpha, linewidth=0, **style)
    there = np.isfinite(lower)
    bars = axis.vlines(moments[there], lower[there], upper[there], label=label, **style)
    return band, bars


def _each(sets: Sets) -> list[AnySet]:
    """The sets one by one."""
    return [
        one for entry in ([sets] if isinstance(sets, Zonotope | ConstrainedZonotope) else sets) for one in _of(entry)
    ]


def _of(batch: AnySet) -> list[AnySet]:
    if not batch.batch:
        return [batch]

    def wide(array: FloatArray, own: int) -> FloatArray:
        return np.broadcast_to(array, (*batch.batch, *array.shape[array.ndim - own :]))

    center, generators = wide(batch.center, 1), wide(batch.generators, 2)
    indices = list(np.ndindex(*batch.batch))
    if isinstance(batch, Zonotope):
        return [Zonotope(center[p], generators[p], batch.direction) for p in indices]
    matrix, offset = wide(batch.constraint_matrix, 2), wide(batch.constraint_offset, 1)
    return [ConstrainedZonotope(center[p], generators[p], matrix[p], offset[p]) for p in indices]


def _check_axes(one: AnySet, axes: tuple[int, int]) -> None:
    if any(not -one.dimension <= a < one.dimension for a in axes):
        raise SetError(f"axes are {tuple(axes)}, expected two coordinates of {one.dimension}")


def _distinct(vertices: FloatArray) -> FloatArray:
    """A closed chain (V, 2) without the vertices that repeat the one before them, up to rounding."""
    if not len(vertices):
        return vertices
    size = float(np.ptp(vertices, axis=0).max()) + np.finfo(np.float64).eps * float(np.abs(vertices).max())
    step = np.abs(vertices - np.roll(vertices, 1, axis=0)).max(axis=1)
    kept = vertices[step > 1e-12 * size]
    return kept if len(kept) else vertices[:1]
