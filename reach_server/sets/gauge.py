"""By how much sets must be scaled to hold a given part of what was measured: makes coverages, and so areas, equal.

The gauge of y in a zonotope ``c + G[-1, 1]^g`` is the least factor t with ``y ∈ c + tG[-1, 1]^g``:

    t = min { |β|_inf : Gβ = y - c } = max { d·(y - c) : |Gᵀd|_1 <= 1 }

Weighted least squares bounds it from both sides [DDFG10]: ``d = (G W Gᵀ)^-1 (y - c)`` gives the
factors ``β = W Gᵀ d``, so ``t <= |β|_inf``, and the direction d, so ``t >= d·(y - c) / |Gᵀd|_1``; with
``W = diag(1 / |Gᵀd|)`` both close in on t.
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from reach_server.numeric.types import FloatArray

#: Relative width at which a factor counts as found; the upper end is returned.
ACCURACY: Final = 2e-3
#: Smallest weight denominators, relative to the largest, round by round: sharp ones at once would stop too early.
_SMOOTHING: Final = tuple(float(0.9**k) for k in range(1, 220))


def common_factor(generators: FloatArray, offset: FloatArray, share: float) -> float:
    """The least factor by which all sets must be scaled about their centres so that ``share`` of the points lie inside.

    ``generators`` (B, n, g), ``offset`` (B, n) point minus centre. Never too small beyond rounding, in general at most
    ``ACCURACY`` (relative) too large. Infinite where flat sets miss too many points.
    """
    count = len(offset)
    rank = int(np.ceil(share * count - 1e-9)) - 1
    lower, upper, settled = _first_bounds(generators, offset)
    todo = np.flatnonzero(~settled)
    weight = np.ones((len(todo), generators.shape[2]))
    for smooth in _SMOOTHING:
        low, high = np.partition(lower, rank)[rank], np.partition(upper, rank)[rank]
        if high <= (1 + ACCURACY) * low or not len(todo):
            break
        # What certainly lies on one side of the wanted rank need not be known better.
        open_ = (upper[todo] > low) & (lower[todo] < high)
        todo, weight = todo[open_], weight[open_]
        below, above, weight = _round(generators[todo], offset[todo], weight, smooth)
        lower[todo] = np.maximum(lower[todo], below)
        upper[todo] = np.minimum(upper[todo], above)
    return float(np.partition(upper, rank)[rank])


def _first_bounds(generators: FloatArray, offset: FloatArray) -> tuple[FloatArray, FloatArray, NDArray[np.bool_]]:
    """Bounds (B,) of each gauge by the interval hull, and which are exact: where a coordinate has no extent."""
    size = np.abs(generators).sum(axis=2)
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.where(offset == 0.0, 0.0, np.abs(offset) / size)
    lower = ratio.max(axis=1)
    return lower, np.full(len(lower), np.inf), np.isinf(lower)


def _round(
    generators: FloatArray, offset: FloatArray, weight: FloatArray, smooth: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """One round: bounds below and above (B,), weights (B, g) of the next."""
    size = np.abs(generators).sum(axis=2, keepdims=True)
    scale = np.where(size > 0, size, 1.0)
    scaled, wanted = generators / scale, (offset[..., None] / scale)[..., 0]
    weighted = scaled * weight[:, None]
    gram = weighted @ np.swapaxes(scaled, 1, 2)
    n = gram.shape[1]
    ridge = 1e-13 * np.maximum(np.trace(gram, axis1=1, axis2=2) / n, 1e-300)
    # A coordinate in which the set is a point has nothing to say: its offset is 0 here.
    flat = np.where(size[..., 0] > 0, 0.0, 1.0)
    gram = gram + (ridge[:, None] + flat)[..., None] * np.eye(n)
    direction = np.linalg.solve(gram, wanted[..., None])
    reach = (np.swapaxes(scaled, 1, 2) @ direction)[..., 0]
    factors = weight * reach
    total = np.abs(reach).sum(axis=1)
    along = (direction[..., 0] * wanted).sum(axis=1)
    below = np.divide(along, total, out=np.zeros_like(along), where=total > 0)
    missed = np.abs((scaled @ factors[..., None])[..., 0] - wanted).max(axis=1)
    above = np.where(missed <= 1e-9 * np.abs(wanted).max(axis=1), np.abs(factors).max(axis=1), np.inf)
    top = np.abs(reach).max(axis=1, keepdims=True)
    return below, above, 1.0 / np.maximum(np.abs(reach), np.where(top > 0, smooth * top, 1.0))
