"""Least squares from covariances, by Cholesky factors of the correlations, compiled."""

import numpy as np

from reach_server.numeric.jit import kernel
from reach_server.numeric.types import BoolArray, FloatArray

#: Pivots of a correlation matrix below this leave the rank to be judged by its eigenvalues.
PIVOT = 1e-8


@kernel
def solve_many(covariance: FloatArray, cross: FloatArray, means: FloatArray, matrix: FloatArray) -> BoolArray:
    """Set ``matrix`` M (B, n, 1 + p) to that of least squares; True (B,) where the rank is certain. Where a pivot is so
    small that it is not, M is not written.

    ``covariance`` of the regressors (B, p, p), ``cross`` of these with the targets (B, p, n), ``means`` (B, p + n).
    """
    count, p, n = cross.shape
    factor, scale, right = np.empty((p, p)), np.empty(p), np.empty(p)
    certain = np.ones(count, np.bool_)
    for b in range(count):
        for c in range(p):
            scale[c] = np.sqrt(max(covariance[b, c, c], 0.0))
            if not scale[c] > 1e-12 * (1.0 + abs(means[b, c])):
                certain[b] = False
        for a in range(p if certain[b] else 0):
            for c in range(a + 1):
                value = covariance[b, a, c] / (scale[a] * scale[c])
                for k in range(c):
                    value -= factor[a, k] * factor[c, k]
                if c < a:
                    factor[a, c] = value / factor[c, c]
                elif value > PIVOT:
                    factor[a, a] = np.sqrt(value)
                else:
                    certain[b] = False
            if not certain[b]:
                break
        if not certain[b]:
            continue
        for i in range(n):
            for a in range(p):
                right[a] = cross[b, a, i] / scale[a]
                for k in range(a):
                    right[a] -= factor[a, k] * right[k]
                right[a] /= factor[a, a]
            for a in range(p - 1, -1, -1):
                for k in range(a + 1, p):
                    right[a] -= factor[k, a] * right[k]
                right[a] /= factor[a, a]
            constant = means[b, p + i]
            for c in range(p):
                matrix[b, i, 1 + c] = right[c] / scale[c]
                constant -= matrix[b, i, 1 + c] * means[b, c]
            matrix[b, i, 0] = constant
    return certain
