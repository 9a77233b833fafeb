"""Predictions held against what was measured."""

import numpy as np
from numpy.typing import NDArray

from reach_server.regression import wrap
from reach_server.sets import membership
from reach_server.sets.arrays import stack_columns
from reach_server.tube import FactorSet
from reach_server.windows import Floats


def inside(
    predicted: FactorSet, measurement: Floats, y: Floats, angles: tuple[int, ...]
) -> tuple[NDArray[np.bool_], Floats]:
    """Whether each measured state (B, n) lies in its set enlarged by ``measurement`` (n, g), and by how much it does
    not: the greatest excess over the interval hull (B,), 0 inside. Angles are compared modulo 2π."""
    generators = stack_columns(predicted.generators, measurement)
    rows = predicted.matrix.shape[1]
    matrix = np.concatenate([predicted.matrix, np.zeros((len(y), rows, measurement.shape[1]))], axis=2)
    point = y.copy()
    for i in angles:
        point[:, i] = predicted.center[:, i] + wrap(y[:, i] - predicted.center[:, i])
    found = membership.contains(predicted.center, generators, matrix, predicted.offset, point)
    half = np.abs(generators).sum(axis=-1)
    excess = np.maximum(np.abs(point - predicted.center) - half, 0.0).max(axis=-1)
    return found, np.where(found, 0.0, excess)
