"""Generators and constraints that say the same as fewer: zero ones, parallel ones, rows that tie nothing down."""

import numpy as np

from reach_server.numeric.types import BoolArray, FloatArray
from reach_server.sets.parts import Parts, common_batch

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


def without_zero_columns(generators: FloatArray, matrix: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Columns that are zero in both are left out (in a batch: as far as all sets have them): exact."""
    n = generators.shape[-2]
    lifted = drop_zero(np.concatenate([generators, matrix], axis=-2))
    return lifted[..., :n, :], lifted[..., n:, :]


def simplify(parts: Parts) -> Parts:
    """The same set without rows and columns that say nothing: exact.

    Rows go that are zero, that repeat another one times a number (up to 8 ulps, as ``merge_parallel``), and that only
    tie down a factor of their own which they leave inside its bounds (a cut that does not cut). Columns of ``[G; A]``
    that are zero go, parallel ones are merged. A row ``0·β = b`` that cannot hold stays.
    """
    center, generators, matrix, offset = common_batch(parts)
    n = generators.shape[-2]
    matrix, offset = _without_slack_rows(generators, matrix, offset)
    # Rows that repeat others are columns of the transposed system.
    system = np.concatenate([matrix, offset[..., None]], axis=-1)
    merged = np.swapaxes(merge_parallel(np.swapaxes(system, -1, -2)), -1, -2)
    filled = np.asarray(merged.any(axis=-1))
    system = np.where(filled[..., None], system, 0.0)
    order = np.argsort(~filled, axis=-1, kind="stable")[..., : int(filled.sum(axis=-1).max(initial=0))]
    system = np.take_along_axis(system, order[..., None], axis=-2)
    lifted = merge_parallel(np.concatenate([generators, system[..., :-1]], axis=-2))
    generators, matrix = without_zero_columns(lifted[..., :n, :], lifted[..., n:, :])
    return center, generators, matrix, system[..., -1]


def _without_slack_rows(
    generators: FloatArray, matrix: FloatArray, offset: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Rows set to 0 whose own factor (no generator, in no other row) can take up all that the others do."""
    size = np.abs(matrix)
    own: BoolArray = ~generators.any(axis=-2) & ((matrix != 0).sum(axis=-2) == 1)
    slack = np.where(own[..., None, :], size, 0.0).max(axis=-1, initial=0.0)
    total = size.sum(axis=-1) - slack + np.abs(offset)
    idle = np.asarray((slack > 0) & (total <= slack))
    return np.where(np.expand_dims(idle, -1), 0.0, matrix), np.where(idle, 0.0, offset)
