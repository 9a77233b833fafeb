"""Generators that say the same as fewer: zero columns and parallel ones."""

import numpy as np

from reach_server.numeric.types import FloatArray

#: Entries of two parallel generators of the same length agree to this many ulps each.
ULPS = 8 * float(np.finfo(np.float64).eps)


def merge_parallel(generators: FloatArray) -> FloatArray:
    """Generators (..., n, g) of the same zonotope with each set of parallel ones merged into its first; exact.

    Two are parallel if, scaled to the same length, every single entry agrees to 8 ulps; so merging changes no entry of
    what is summed by more than that. Merged ones leave zero columns behind.
    """
    g = generators.shape[-1]
    if g < 2:
        return generators
    result = np.array(generators)
    for leader in range(g - 1):
        first = result[..., :, leader]
        longest = np.abs(first).argmax(axis=-1)[..., None, None]
        rest = result[..., :, leader + 1 :]
        own = np.take_along_axis(first[..., None], longest, axis=-2)
        lengths = np.take_along_axis(rest, longest, axis=-2)
        shares = lengths / np.where(own == 0, 1.0, own)
        expected = first[..., None] * shares
        parallel = (np.abs(rest - expected) <= ULPS * np.abs(expected)).all(axis=-2, keepdims=True)
        parallel &= lengths != 0
        growth = 1.0 + np.where(parallel, np.abs(shares), 0.0).sum(axis=-1)
        result[..., :, leader] = first * growth
        result[..., :, leader + 1 :] = np.where(parallel, 0.0, rest)
    return result


def drop_zero(generators: FloatArray) -> FloatArray:
    """Generators (..., n, g') without zero columns: exact. A batch keeps as many as its largest set needs; the others
    have zero columns at the end."""
    full = (generators != 0).any(axis=-2)
    g = generators.shape[-1]
    needed = int(full.sum(axis=-1).max(initial=0))
    if needed == g:
        return generators
    order = np.argsort(~full, axis=-1, kind="stable")[..., :needed]
    return np.take_along_axis(generators, order[..., None, :], axis=-1)
