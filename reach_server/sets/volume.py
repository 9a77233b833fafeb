"""Volumes of zonotopes between two bounds, however many generators there are."""

from math import comb

import numpy as np

from reach_server.numeric.rounding import EPS
from reach_server.numeric.types import FloatArray
from reach_server.sets.order_reduction import girard, pca
from reach_server.sets.polygon import zonotope_area, zonotope_volume

#: Determinants per set up to which the volume is computed exactly.
EXACT = 2_000


def volume_bracket(generators: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(inner, outer) bounds (...) of the volume of zonotopes with generators (..., n, g).

    In the plane, and up to 2000 determinants, both are the exact volume, apart by 64 n² ulps of the interval hull's
    volume for rounding. Beyond: ``Σ det² = det(GGᵀ)`` over the choices of n generators (Cauchy, Binet), so
    ``2ⁿ sqrt(det GGᵀ) <= V <= 2ⁿ sqrt(C(g, n) det GGᵀ)``; the inner bound is at least the volume of the longest
    generators alone, the outer one at most that of a reduced set and of the interval hull.
    """
    n, g = generators.shape[-2:]
    widths = np.abs(generators).sum(axis=-1)
    # One size for every coordinate: the determinants neither overflow nor underflow.
    scaled = generators / np.where(widths > 0, widths, 1.0)[..., None]
    hull = 2.0**n * np.where((widths > 0).all(axis=-1), 1.0, 0.0)
    margin = (64 * n**2 + 8 * g) * EPS * hull
    if n == 2 or comb(g, n) <= EXACT:
        exact = zonotope_area(scaled) if n == 2 else zonotope_volume(scaled)
        inner = outer = exact
    else:
        gram = np.maximum(np.linalg.det(scaled @ np.swapaxes(scaled, -1, -2)), 0.0)
        few = max(k for k in range(n, g) if comb(k, n) <= EXACT)
        longest = np.argsort(-(scaled**2).sum(axis=-2), axis=-1, kind="stable")[..., None, :few]
        part = zonotope_volume(np.take_along_axis(scaled, longest, axis=-1))
        inner = np.maximum(2.0**n * np.sqrt(gram) * (1 - n * EPS), part)
        outer = 2.0**n * np.sqrt(comb(g, n) * (gram + margin))
        for reduced in (girard(scaled, few), pca(scaled, few)):
            outer = np.minimum(outer, zonotope_volume(reduced))
    inner, outer = np.maximum(inner - margin, 0.0), np.minimum(outer + margin, hull * (1 + g * n * EPS))
    unit = widths.prod(axis=-1)
    return np.asarray(inner * unit * (1 - 2 * n * EPS)), np.asarray(outer * unit * (1 + 2 * n * EPS))
