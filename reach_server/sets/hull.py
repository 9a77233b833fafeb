"""Convex hulls of two sets: a zonotope around it, and the constrained zonotope that it is."""

import numpy as np

from reach_server.numeric.checks import stack_columns
from reach_server.numeric.types import FloatArray
from reach_server.sets.parts import Parts, batch_of, joined_constraints


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


def constrained_hull(first: Parts, second: Parts) -> Parts:
    """The parts of the least convex set around both: exact [RK22, theorem 5].

    ``x = λ x1 + (1 - λ) x2`` with ``λ = (1 + ξ)/2``; the factors are (λβ1, (1 - λ)β2, ξ, slacks).
    """
    n, g1, g2 = first[1].shape[-2], first[1].shape[-1], second[1].shape[-1]
    g = g1 + g2
    batch = batch_of(first, second)
    half_shift = np.broadcast_to((first[0] - second[0])[..., None] / 2, (*batch, n, 1))
    generators = stack_columns(first[1], second[1], half_shift, np.zeros((n, 2 * g)))
    joined, offset = joined_constraints(first, second)
    rows = joined.shape[-2]
    first_rows = first[2].shape[-2]
    matrix = np.zeros((*batch, rows + 2 * g, 3 * g + 1))
    right = np.full((*batch, rows + 2 * g), -0.5)
    matrix[..., :rows, :g] = joined
    sign = np.where(np.arange(rows) < first_rows, -0.5, 0.5)
    matrix[..., :rows, g] = sign * offset
    right[..., :rows] = offset / 2
    # |λβ1| <= λ and |(1 - λ)β2| <= 1 - λ, each side with a slack.
    own = np.where(np.arange(g) < g1, -0.5, 0.5)
    matrix[..., rows:, :g] = np.concatenate([np.eye(g), -np.eye(g)])
    matrix[..., rows:, g] = np.concatenate([own, own])
    matrix[..., rows:, g + 1 :] = np.eye(2 * g)
    return (first[0] + second[0]) / 2, generators, matrix, right
