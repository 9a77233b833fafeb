"""Zonotopes around constrained zonotopes: the smallest of what several ways to forget the constraints give."""

import numpy as np

from reach_server.numeric.checks import stack_columns
from reach_server.numeric.intervals import Interval
from reach_server.numeric.rounding import EPS
from reach_server.numeric.types import FloatArray
from reach_server.sets import constraint_reduction, factor_bounds, support
from reach_server.sets.halfspace import log_size
from reach_server.sets.parts import Parts, common_batch


def enclosing_zonotope(parts: Parts) -> tuple[FloatArray, FloatArray]:
    """Center and generators of a zonotope around constrained zonotopes: outer.

    Without the constraints, over what these leave the factors, with all constraints eliminated, and the interval hull:
    the smallest by area, or by the widths, with n generators more that hold what rounding may have lost.
    """
    n = parts[1].shape[-2]
    lower, upper = support.interval_hull(parts)
    parts = common_batch(parts)
    g = max(parts[1].shape[-1], n)
    bounded = factor_bounds.within_bounds(parts)
    eliminated = constraint_reduction.eliminate_all(parts)
    inhabited = np.isfinite(lower).all(axis=-1, keepdims=True)
    interval = Interval(np.where(inhabited, lower, parts[0]), np.where(inhabited, upper, parts[0]))
    hull = (interval.midpoint, interval.radius[..., None] * np.eye(n))
    options = [parts[:2], bounded, eliminated[:2], hull]
    centers = np.stack([np.broadcast_to(c, parts[0].shape) for c, _ in options], axis=-2)
    padded = np.zeros((*parts[1].shape[:-2], len(options), n, g))
    for k, (_, generators) in enumerate(options):
        padded[..., k, :, : generators.shape[-1]] = generators
    best = log_size(padded, None).argmin(axis=-1)[..., None, None]
    center = np.take_along_axis(centers, best, axis=-2)[..., 0, :]
    generators = np.take_along_axis(padded, best[..., None], axis=-3)[..., 0, :, :]
    # What sums and elimination may have lost; flat sets show it.
    size = np.abs(parts[1]).sum(axis=-1)
    terms = np.abs(generators).sum(axis=-1) + np.abs(parts[0]) + np.abs(center) + size
    rounding = (((g + 8) * EPS) * terms + eliminated[2])[..., None] * np.eye(n)
    return center, stack_columns(generators, rounding)
