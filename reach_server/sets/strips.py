"""Zonotope and strip: enclosures of ``{x in Z : lower <= H x <= upper}``."""

from typing import Literal, get_args

import numpy as np
from numpy.typing import ArrayLike

from reach_server.sets.arrays import Array, Mask, SetError, checked, checked_batch, checked_bounds
from reach_server.sets.intervals import EPS, Interval, add_down, add_up
from reach_server.sets.planar import zonotope_area

StripMethod = Literal["tight", "frobenius"]

#: A strip is taken to miss the set only if it does so by more than this, relative to the numbers compared.
EMPTY_MARGIN = 1e-9


def known(method: StripMethod) -> StripMethod:
    """The method, if there is one of that name; ``SetError`` otherwise."""
    if method not in get_args(StripMethod):
        raise SetError(f"method is {method!r}, expected one of {', '.join(get_args(StripMethod))}")
    return method


def bounds(q: ArrayLike, r: ArrayLike, batch: tuple[int, ...]) -> tuple[Array, Array]:
    """``q - r`` and ``q + r`` (...) of the strip ``|Hx - q| <= r``, rounded outwards; r = inf: no bounds."""
    middle, radius = _number(q, "q", batch), _radius(r, batch)
    checked_batch(radius, 0, "r", middle.shape)
    finite = np.where(np.isinf(radius), 0.0, radius)
    lower, upper = add_down(middle, -finite), add_up(middle, finite)
    return np.where(np.isinf(radius), -np.inf, lower), np.where(np.isinf(radius), np.inf, upper)


def linearised(
    normal: Array,
    center: Array,
    h0: ArrayLike,
    remainder: tuple[ArrayLike, ArrayLike],
    r: ArrayLike,
    batch: tuple[int, ...],
) -> tuple[Array, Array]:
    """Lower and upper bound (...) of ``J x`` for J (..., n) that ``|h(x)| <= r`` implies: outer.

    ``h(x)`` is in ``h0 + J(x - center) + [lower, upper]``, so ``-r - upper <= h0 + J(x - center) <= r - lower``. Where
    the remainder, or r, is infinite on a side, that side does not bind. Sums are rounded outwards, that of ``J center``
    by its terms.
    """
    value, radius = _number(h0, "h0", batch), _radius(r, batch)
    low, high = (checked_batch(b, 0, "remainder", batch) for b in checked_bounds(remainder, "remainder", ()))
    middle = Interval.of(center).linear_map(normal[..., None, :])[..., 0] - value
    return add_down(middle.lower, -_sum(radius, high)), add_up(middle.upper, _sum(radius, -low))


def _number(value: ArrayLike, name: str, batch: tuple[int, ...]) -> Array:
    return checked_batch(checked(value, name, ()), 0, name, batch)


def _radius(r: ArrayLike, batch: tuple[int, ...]) -> Array:
    radius = checked_batch(checked(r, "r", (), infinite=True), 0, "r", batch)
    if (radius < 0).any():
        raise SetError(f"r must not be negative, its least value is {radius.min()}")
    return radius


def _sum(radius: Array, excess: Array) -> Array:
    """``radius + excess`` rounded up; infinite where one of them is infinite."""
    infinite = np.isinf(radius) | np.isinf(excess)
    return np.where(infinite, np.inf, add_up(np.where(infinite, 0.0, radius), np.where(infinite, 0.0, excess)))


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
    # What the sums may have lost does not shrink with them: of 1e12 - 1e12 nothing is left but the rounding.
    size = (np.abs(normal) * (np.abs(center) + np.abs(generators).sum(axis=-1))).sum(axis=-1)
    lost = sum(generators.shape[-2:]) * EPS * size
    margin = EMPTY_MARGIN * (np.abs(middle) + reach + np.abs(np.where(np.isfinite(low), low, 0.0))) + lost
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
    frobenius = _divided(spread[..., 0], denominator[..., None])
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
    bravo = _divided(columns, np.where(usable, slopes, 0.0)[..., None, :])
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


def _divided(numerator: Array, denominator: Array) -> Array:
    """The quotient; 0, which is as good a λ as any, where dividing by 0 or by hardly more gives no number."""
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        quotient = numerator / denominator
    return np.where(np.isfinite(quotient), quotient, 0.0)


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
