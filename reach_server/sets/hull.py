"""Zonotopes around the convex hull of two."""

import numpy as np

from reach_server.numeric.checks import stack_columns
from reach_server.numeric.types import FloatArray


def zonotope_hull(
    center: FloatArray, generators: FloatArray, other_center: FloatArray, other_generators: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Center (..., n) and generators (..., n, g1 + g2 + 1) of a zonotope around both: outer [Gir05].

    ``<(c1 + c2)/2, [(G1 + G2)/2, (c1 - c2)/2, (G1 - G2)/2]>`` with G1 and G2 paired by likeness: it is convex and holds
    both sets, whichever columns are paired and whatever their signs. A column without a partner stays as it is.
    """
    batch = np.broadcast_shapes(
        center.shape[:-1], generators.shape[:-2], other_center.shape[:-1], other_generators.shape[:-2]
    )
    first, second = (np.broadcast_to(g, (*batch, *g.shape[-2:])) for g in (generators, other_generators))
    if first.shape[-1] < second.shape[-1]:
        first, second = second, first
    pairs = second.shape[-1]
    partner = _partners(first, second)
    paired = np.take_along_axis(first, partner[..., None, :], axis=-1)
    sign = np.where((paired * second).sum(axis=-2, keepdims=True) < 0, -1.0, 1.0)
    free = np.ones((*batch, first.shape[-1]), dtype=bool)
    np.put_along_axis(free, partner, False, axis=-1)
    left_over = np.argsort(~free, axis=-1, kind="stable")[..., : first.shape[-1] - pairs]
    alone = np.take_along_axis(first, left_over[..., None, :], axis=-1)
    middle, half = (center + other_center) / 2, ((center - other_center) / 2)[..., None]
    mean, rest = (paired + sign * second) / 2, (paired - sign * second) / 2
    return middle, stack_columns(mean, alone, half, rest)


def _partners(first: FloatArray, second: FloatArray) -> np.ndarray[tuple[int, ...], np.dtype[np.intp]]:
    """For each column of ``second`` (..., n, p) a column of ``first`` (..., n, g >= p) of its own (..., p), the pairs
    with the greatest products first."""
    likeness = np.abs(np.swapaxes(second, -1, -2) @ first)
    p, g = likeness.shape[-2:]
    partner = np.zeros((*likeness.shape[:-2], p), dtype=np.intp)
    for _ in range(p):
        best = likeness.reshape(*likeness.shape[:-2], p * g).argmax(axis=-1)[..., None]
        row, column = best // g, best % g
        np.put_along_axis(partner, row, column, axis=-1)
        np.put_along_axis(likeness, row[..., None], -1.0, axis=-2)
        np.put_along_axis(likeness, column[..., None], -1.0, axis=-1)
    return partner
