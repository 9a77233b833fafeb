"""Fewer generators: enclosures of a zonotope by one of lower order."""

import numpy as np

from reach_server.sets.arrays import Array


def girard(generators: Array, count: int) -> Array:
    """Generators (..., n, g) of an enclosing zonotope with at most ``max(count, n)`` columns; an outer bound.

    Keeps the columns that are least like a box and encloses the sum of the others by a box, whose n columns
    come last ([Gir05], section 3.4). Each set of the batch is reduced by its own ranking. Returned unchanged
    if there are few enough columns.
    """
    n, g = generators.shape[-2:]
    if g <= max(count, n):
        return generators
    kept = max(count, n) - n
    size = np.abs(generators)
    boxiness = size.sum(axis=-2) - size.max(axis=-2)
    order = np.argsort(-boxiness, axis=-1, kind="stable")
    ranked = np.take_along_axis(generators, order[..., None, :], axis=-1)
    half_widths = np.abs(ranked[..., kept:]).sum(axis=-1)
    box = half_widths[..., None] * np.eye(n)
    return np.concatenate([ranked[..., :kept], box], axis=-1)


def boxed(generators: Array, count: int) -> Array:
    """Like ``girard``, but the last n columns of the result always form a diagonal matrix; an outer bound.

    A caller that has to enlarge the set in some coordinate (rounding) can do it on these columns.
    """
    n, g = generators.shape[-2:]
    box = np.zeros((*generators.shape[:-2], n, n))
    if g + n <= max(count, n):
        return np.concatenate([generators, box], axis=-1)
    return girard(np.concatenate([generators, box], axis=-1), count)
