"""Constrained zonotopes as plain arrays: ``(center, generators, constraint_matrix, constraint_offset)``.

Batch axes are as in the class: each array has its own, and they are broadcast. A zonotope has no rows.
"""

import numpy as np
from numpy.typing import NDArray

from reach_server.numeric.checks import block_diagonal
from reach_server.numeric.types import FloatArray

Parts = tuple[FloatArray, FloatArray, FloatArray, FloatArray]
Indices = NDArray[np.intp]


def without_rows(center: FloatArray, generators: FloatArray) -> Parts:
    """The parts of a zonotope."""
    return center, generators, np.zeros((0, generators.shape[-1])), np.zeros(0)


def batch_of(*sets: Parts) -> tuple[int, ...]:
    """The batch axes that these sets have together."""
    own = (1, 2, 2, 1)
    shapes = (array.shape[: array.ndim - axes] for parts in sets for array, axes in zip(parts, own, strict=True))
    return np.broadcast_shapes(*shapes)


def common_batch(parts: Parts, batch: tuple[int, ...] = ()) -> Parts:
    """The parts with all batch axes, and at least ``batch``, written out."""
    center, generators, matrix, offset = parts
    common = np.broadcast_shapes(batch, batch_of(parts))
    return (
        np.broadcast_to(center, common + center.shape[-1:]),
        np.broadcast_to(generators, common + generators.shape[-2:]),
        np.broadcast_to(matrix, common + matrix.shape[-2:]),
        np.broadcast_to(offset, common + offset.shape[-1:]),
    )


def at(parts: Parts, index: tuple[int, ...]) -> Parts:
    """The parts of one set of a batch with all axes written out."""
    center, generators, matrix, offset = parts
    return center[index], generators[index], matrix[index], offset[index]


def joined_constraints(first: Parts, second: Parts) -> tuple[FloatArray, FloatArray]:
    """Matrix (..., c1 + c2, g1 + g2) and offset (..., c1 + c2) of the constraints of both, each on its own factors."""
    matrix = block_diagonal(first[2], second[2])
    offsets = (first[3], second[3])
    batch = np.broadcast_shapes(matrix.shape[:-2], *(o.shape[:-1] for o in offsets))
    return matrix, np.concatenate([np.broadcast_to(o, (*batch, o.shape[-1])) for o in offsets], axis=-1)
