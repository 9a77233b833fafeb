"""Zonotope and strip: enclosures of ``{x in Z : lower <= H x <= upper}``."""

from typing import Literal

import numpy as np

from reach_server.sets.arrays import Array, Mask
from reach_server.sets.planar import zonotope_area

StripMethod = Literal["tight", "frobenius"]

#: A strip is taken to miss the set only if it does so by more than this, relative to the numbers compared.
EMPTY_MARGIN = 1e-9


def strip_bounds(
    center: Array, generators: Array, normal: Array, lower: Array, upper: Array
) -> tuple[Array, Array, Mask, Mask]:
    """The strip tightened to the set: (center (...), radius (...), cuts (...) bool, empty (...) bool).

    ``cuts`` is False where the strip holds on the whole set; ``empty`` is certain: the strip and the set are
    disjoint by more than the rounding of the comparison.
    """
    middle = (normal * center).sum(axis=-1)
    reach = np.abs((normal[..., None, :] @ generators)[..., 0, :]).sum(axis=-1)
    low, high = np.maximum(lower, middle - reach), np.minimum(upper, middle + reach)
    margin = EMPTY_MARGIN * (np.abs(middle) + reach + np.abs(np.where(np.isfinite(low), low, 0.0)))
    empty = low > high + margin
    cuts = ((lower > middle - reach) | (upper < middle + reach)) & ~empty
    # Within the margin the two may cross by rounding: keep the hull of both, which only enlarges.
    low, high = np.minimum(low, high), np.maximum(low, high)
    return (low + high) / 2, (high - low) / 2, cuts, empty


def intersect_strip(
    center: Array,
    generators: Array,
    normal: Array,
    lower: Array,
    upper: Array,
    *,
    method: StripMethod = "tight",
    plane: tuple[int, int] | None = None,
    candidates: int = 8,
) -> tuple[Array, Array, Mask]:
    """Center, generators (..., n, g + 1) of a zonotope around the intersection, and where it is certainly empty.

    For every vector λ the zonotope ``<c + λ(q - Hc), [(I - λH)G, λr]>`` contains the intersection with
    ``|Hx - q| <= r`` [ABC05, section 4]; λ = 0 leaves the set as it is. An outer bound.

    ``frobenius`` takes the λ of least Frobenius norm and the strip as given (the paper's Algorithm 2; the
    result may be larger than the set). ``tight`` first tightens the strip to the set, then takes the best of
    the Frobenius λ, Bravo's ``λ_j = g_j / (H g_j)`` for the generators that matter most to H, and λ = 0: never
    larger than the set. Best means the least area in ``plane`` (or of a planar set) times the product of the
    widths of the other coordinates; without a plane, the least product of all widths.

    An empty intersection, and a strip that does not cut, return the set unchanged (with a zero generator).
    """
    q, r, cuts, empty = strip_bounds(center, generators, normal, lower, upper)
    if method == "frobenius":
        two_sided = np.isfinite(lower) & np.isfinite(upper)
        q = np.where(two_sided, (np.where(two_sided, lower, 0.0) + np.where(two_sided, upper, 0.0)) / 2, q)
        r = np.where(two_sided, (np.where(two_sided, upper, 0.0) - np.where(two_sided, lower, 0.0)) / 2, r)
        acts = (two_sided | cuts) & ~empty
    else:
        acts = cuts
    # A half-space at infinity that misses the set has no radius to compute with.
    q, r = np.where(acts, q, 0.0), np.where(acts, r, 0.0)
    heights = (normal[..., None, :] @ generators)[..., 0, :]
    spread = generators @ heights[..., None]
    denominator = (heights**2).sum(axis=-1) + r**2
    frobenius = spread[..., 0] / np.where(denominator > 0, denominator, 1.0)[..., None]
    if method == "frobenius":
        chosen = frobenius
    else:
        chosen = _best_lambda(generators, normal, r, heights, frobenius, plane, candidates)
    chosen = np.where(acts[..., None], chosen, 0.0)
    shift = (q - (normal * center).sum(axis=-1))[..., None]
    new_center = center + chosen * np.where(acts[..., None], shift, 0.0)
    return new_center, _cut_generators(generators, heights, chosen, r), empty


def _cut_generators(generators: Array, heights: Array, chosen: Array, radius: Array) -> Array:
    """``[(I - λH)G, λr]`` for λ (..., n), HG (..., g) and r (...)."""
    moved = generators - chosen[..., :, None] * heights[..., None, :]
    added = (chosen * radius[..., None])[..., None]
    return np.concatenate([moved, np.broadcast_to(added, (*moved.shape[:-1], 1))], axis=-1)


def _best_lambda(
    generators: Array,
    normal: Array,
    radius: Array,
    heights: Array,
    frobenius: Array,
    plane: tuple[int, int] | None,
    candidates: int,
) -> Array:
    n, g = generators.shape[-2:]
    count = min(candidates, g)
    batch = np.broadcast_shapes(heights.shape[:-1], frobenius.shape[:-1])
    strongest = np.argsort(-np.abs(heights), axis=-1, kind="stable")[..., :count]
    columns = np.take_along_axis(
        np.broadcast_to(generators, (*batch, n, g)),
        np.broadcast_to(strongest, (*batch, count))[..., None, :],
        axis=-1,
    )
    slopes = np.take_along_axis(
        np.broadcast_to(heights, (*batch, g)), np.broadcast_to(strongest, (*batch, count)), axis=-1
    )
    usable = np.abs(slopes) > 1e-12 * np.abs(heights).sum(axis=-1, keepdims=True)
    bravo = np.where(usable[..., None, :], columns / np.where(usable, slopes, 1.0)[..., None, :], 0.0)
    options = np.concatenate(
        [
            np.zeros((*batch, 1, n)),
            np.broadcast_to(frobenius, (*batch, n))[..., None, :],
            np.swapaxes(bravo, -1, -2),
        ],
        axis=-2,
    )
    cut = _cut_generators(generators[..., None, :, :], heights[..., None, :], options, radius[..., None])
    best = np.argmin(log_size(cut, plane), axis=-1)
    return np.take_along_axis(options, best[..., None, None], axis=-2)[..., 0, :]


def log_size(generators: Array, plane: tuple[int, int] | None) -> Array:
    """Logarithm of the size that ``tight`` compares (see ``intersect_strip``).

    A factor of zero counts as the least positive number: a coordinate in which the set is a point stays one under
    every candidate, and must not hide what they do to the others.
    """
    tiny = np.finfo(np.float64).tiny
    n = generators.shape[-2]
    if n == 2:
        plane = (0, 1)
    others = [i for i in range(n) if plane is None or i not in plane]
    size = np.log(np.maximum(2 * np.abs(generators[..., others, :]).sum(axis=-1), tiny)).sum(axis=-1)
    if plane is not None:
        size = size + np.log(np.maximum(zonotope_area(generators[..., plane, :]), tiny))
    return np.asarray(size)
