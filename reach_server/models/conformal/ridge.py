"""Compiled: ridge regression of all horizon steps with one Gram matrix and one Cholesky factor.

    M_h = argmin Σ |d_{k+h} - M_h φ_h|² + λ Σ_j S_j |M_j|² ,  S_j = Σ (φ_j - mean)² or more, the constant is free

Step h uses the front part φ_h of the features, and the factor of a front block is the front block of the factor: so
``L Lᵀ = Σ φ φᵀ + λ S`` serves every step. Right sides and solutions of all steps and states stand
side by side as columns (total, N n), those of step h at h n; a row of features meets only the columns of the steps that
use it, which are the last ones. Loops run along rows, where terms of different columns are added, never terms of a sum:
these the processor may take several at once without any change of their order.
"""

import math

import numpy as np

from reach_server.models.conformal.spec import FeatureSpec
from reach_server.numeric.jit import kernel
from reach_server.numeric.types import FloatArray, IntArray

#: Features are believed this many times as far from their mean as any was in the data; beyond that they are cut off.
BELIEVED = 2.0
#: Pivots of the factor are at least this part of the number of data: what rounding leaves.
LEAST_PIVOT = 1e-13


@kernel
def standardise(phi: FloatArray, mean: FloatArray, scale: FloatArray, limit: FloatArray, out: FloatArray) -> None:
    """Features (total,) in units of their spread, cut off at ``limit``."""
    for j in range(len(phi)):
        out[j] = min(max((phi[j] - mean[j]) / scale[j], -limit[j]), limit[j])


@kernel
def first_columns(spec: FeatureSpec) -> IntArray:
    """Where the columns of the steps begin that use each feature (total,)."""
    begin = np.zeros(spec.total, dtype=np.int64)
    for j in range(spec.base, spec.total):
        begin[j] = spec.n * ((j - spec.base) // spec.later + 1)
    return begin


@kernel
def add(z: FloatArray, y: FloatArray, weight: float, gram: FloatArray, cross: FloatArray) -> None:
    """Add ``weight`` times a datum to ``Σ z zᵀ`` (lower triangle) and ``Σ z y``."""
    columns = len(y)
    for i in range(len(z)):
        a = weight * z[i]
        row = gram[i]
        for j in range(i + 1):
            row[j] += a * z[j]
        right = cross[i]
        for c in range(columns):
            right[c] += a * y[c]


@kernel
def factor(gram: FloatArray, ridge: float, lower: FloatArray) -> None:
    """``lower`` with ``lower lowerᵀ = gram + ridge S``; the first feature is the constant."""
    size = len(gram)
    least = LEAST_PIVOT * max(gram[0, 0], 1.0)
    for i in range(size):
        for j in range(i + 1):
            lower[i, j] = gram[i, j]
        if i > 0:
            variation = gram[i, i] - gram[i, 0] * gram[i, 0] / max(gram[0, 0], 1.0)
            lower[i, i] += ridge * max(variation, gram[0, 0]) + least
    column = lower[:, 0].copy()
    for j in range(size):
        pivot = math.sqrt(max(lower[j, j], least))
        lower[j, j] = pivot
        for i in range(j + 1, size):
            lower[i, j] /= pivot
            column[i] = lower[i, j]
        for i in range(j + 1, size):
            a = column[i]
            row = lower[i]
            for k in range(j + 1, i + 1):
                row[k] -= a * column[k]


@kernel
def solve(lower: FloatArray, cross: FloatArray, begin: IntArray, matrix: FloatArray) -> None:
    """``matrix`` (total, N n): the coefficients of every step on the features that it uses, 0 elsewhere; ``begin`` as
    ``first_columns`` says."""
    size, columns = cross.shape
    for i in range(size):
        row = matrix[i]
        for c in range(columns):
            row[c] = cross[i, c] if c >= begin[i] else 0.0
        for j in range(i):
            a = lower[i, j]
            other = matrix[j]
            for c in range(begin[i], columns):
                row[c] -= a * other[c]
        a = 1.0 / lower[i, i]
        for c in range(begin[i], columns):
            row[c] *= a
    for i in range(size - 1, -1, -1):
        row = matrix[i]
        for j in range(i + 1, size):
            a = lower[j, i]
            other = matrix[j]
            for c in range(begin[j], columns):
                row[c] -= a * other[c]
        a = 1.0 / lower[i, i]
        for c in range(begin[i], columns):
            row[c] *= a


@kernel
def increments_of(z: FloatArray, matrix: FloatArray, begin: IntArray, out: FloatArray) -> None:
    """Predicted increments ``out`` (N n,) of all steps at standardised features."""
    columns = len(out)
    for c in range(columns):
        out[c] = 0.0
    for j in range(len(z)):
        a = z[j]
        row = matrix[j]
        for c in range(begin[j], columns):
            out[c] += a * row[c]
