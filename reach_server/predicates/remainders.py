"""Upper bounds of the second-order remainder of a linear bound: ``½ dᵀH d`` over a zonotope and all H between bounds.

With ``H = M + E``, ``|E| <= R`` entry by entry, and ``d = Gξ``, ``|ξ| <= 1`` (the quadratic map of a zonotope [Alt10]):

    ½ dᵀH d <= Σ_i max(Q_ii, 0) + Σ_{i≠j} |Q_ij| + ½ |d|ᵀ R |d| ,   Q = ½ GᵀMG ,

since squares of factors lie in [0, 1] and products of two in [-1, 1]. Over the box of the zonotope alone each entry of
H may be taken at its worst, and ``½ max(λ, 0) |d|²`` bounds it where λ bounds the eigenvalues. Each of the three can be
the least. All results are rounded up; they are +inf where an entry of H is not bounded.
"""

import numpy as np

from reach_server.numeric.rounding import EPS, add_up, sum_up
from reach_server.numeric.types import FloatArray
from reach_server.predicates.interval_ad.arithmetic import Bounds, magnitude
from reach_server.predicates.interval_ad.linear_range import product
from reach_server.sets.order_reduction import girard

#: Generators that are mapped one by one.
MAPPED = 20


def middle(bounds: Bounds) -> tuple[FloatArray, FloatArray]:
    """Midpoint and radius of intervals, rounded so that they cover them; 0 and +inf where they are not bounded."""
    finite = np.isfinite(bounds[0]) & np.isfinite(bounds[1])
    low, high = np.where(finite, bounds[0], 0.0), np.where(finite, bounds[1], 0.0)
    mid = low / 2 + high / 2
    return mid, np.where(finite, np.maximum(add_up(high, -mid), add_up(mid, -low)), np.inf)


def upper_dot(a: FloatArray, b: FloatArray) -> FloatArray:
    """Sum of the products of numbers that are not negative, over the last axis, rounded up; 0 times inf is 0."""
    return sum_up(product(a, b)[1])


def greatest_quadratic(hessian: Bounds, generators: FloatArray, curvature: FloatArray) -> FloatArray:
    """Upper bound (R,) of ``½ dᵀH d`` over zonotopes about 0 with generators (R, s, g), H in bounds (R, s, s).

    No eigenvalue of H is greater than ``curvature`` (R,).
    """
    greatest = np.zeros(len(generators))
    bent = curvature > 0
    if bent.any():
        low, high, generators = hessian[0][bent], hessian[1][bent], generators[bent]
        half = sum_up(np.abs(generators))
        by_curvature = product(0.5 * curvature[bent], upper_dot(half, half))[1]
        largest = magnitude((low, high))[1]
        diagonal = np.arange(largest.shape[1])
        largest[:, diagonal, diagonal] = np.maximum(high[:, diagonal, diagonal], 0.0)
        least = np.minimum(np.minimum(_mapped((low, high), generators), _half_form(largest, half)), by_curvature)
        # Where numbers overflowed nothing is known; d = 0 is always among the d.
        greatest[bent] = np.where(np.isnan(least), np.inf, np.maximum(least, 0.0))
    return greatest


def _mapped(hessian: Bounds, generators: FloatArray) -> FloatArray:
    """The bound by the quadratic map of the generators, and of a box in place of those beyond the longest."""
    generators = girard(generators, MAPPED + generators.shape[1])
    half = sum_up(np.abs(generators))
    mid, radius = middle(hessian)
    form = 0.5 * np.swapaxes(generators, 1, 2) @ mid @ generators
    diagonal = np.diagonal(form, axis1=1, axis2=2)
    total = np.abs(form).sum(axis=(1, 2)) - np.abs(np.minimum(diagonal, 0.0)).sum(axis=1)
    # What the products and sums may have lost is relative to their terms, not to what cancels.
    lost = (4 * generators.shape[1] + generators.shape[2] ** 2 + 8) * EPS * _half_form(np.abs(mid), half)
    return add_up(add_up(total, lost), _half_form(radius, half))


def greatest_curvature(hessian: Bounds) -> FloatArray:
    """Upper bound (R,) of the eigenvalues of all symmetric matrices within bounds (R, s, s).

    The lesser of the bounds by Gershgorin's discs and by the spectrum of the midpoint plus the norm of the radius.
    """
    size = hessian[0].shape[1]
    if not size:
        return np.zeros(len(hessian[0]))
    largest = magnitude(hessian)[1]
    diagonal = np.arange(size)
    largest[:, diagonal, diagonal] = 0.0
    found = add_up(hessian[1][:, diagonal, diagonal], sum_up(largest)).max(axis=1)
    mid, radius = middle(hessian)
    curved = (found > 0) | ((found == 0) & largest.any(axis=(1, 2)))
    doubtful = curved & np.isfinite(radius).all(axis=(1, 2)) & np.isfinite(mid).all(axis=(1, 2))
    if size > 1 and doubtful.any():
        mid, radius = mid[doubtful], radius[doubtful]
        spectrum = np.linalg.eigvalsh(mid)[:, -1]
        # A backward stable solver is wrong by a small multiple of the norm's rounding.
        wrong = 32 * size * EPS * sum_up(np.abs(mid)).max(axis=1)
        spectral = add_up(add_up(spectrum, wrong), sum_up(radius).max(axis=1))
        found[doubtful] = np.where(np.isnan(spectral), found[doubtful], np.minimum(found[doubtful], spectral))
    return np.asarray(found)


def _half_form(matrix: FloatArray, half: FloatArray) -> FloatArray:
    """``½ hᵀ A h`` for A and h that are not negative, rounded up."""
    rows = upper_dot(matrix, half[:, None, :])
    return upper_dot(half, 0.5 * rows)
