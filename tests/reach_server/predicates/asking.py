"""Contexts, sets and points for the tests of predicates."""

from collections.abc import Mapping

import numpy as np
from shapely import Polygon

from reach_server.numeric.types import BoolArray, FloatArray
from reach_server.predicates import Context, Strips
from reach_server.sets import polygon as planar


def context(rows: int, n: int, **given: FloatArray | float) -> Context:
    """A context of zeros but for what is given."""
    fields: Mapping[str, FloatArray | float] = {
        "t": np.zeros(rows), "k": np.zeros(rows), "last_t": np.zeros(rows), "last_lower": np.zeros((rows, n)),
        "last_upper": np.zeros((rows, n)), "t_slack": 0.0, **given,
    }  # fmt: skip
    return Context(**fields)  # type: ignore[arg-type]


def factors(rng: np.random.Generator, *shape: int) -> FloatArray:
    """Numbers in [-1, 1], many of them at the ends."""
    inside = rng.uniform(-1, 1, shape)
    return np.where(rng.random(shape) < 0.4, np.sign(inside), inside)


def members(rng: np.random.Generator, center: FloatArray, generators: FloatArray, count: int) -> FloatArray:
    """Points (R, count, n) of zonotopes."""
    rows, _, g = generators.shape
    return np.asarray(center[:, None] + factors(rng, rows, count, g) @ np.swapaxes(generators, 1, 2))


def kept(strips: Strips, points: FloatArray) -> BoolArray:
    """Which points (R, K, n) obey all strips, up to rounding."""
    rows = len(points)
    normal = np.broadcast_to(strips.normal, (rows, *strips.normal.shape[-2:]))
    lower, upper = (np.broadcast_to(b, (rows, normal.shape[1]))[:, None] for b in (strips.lower, strips.upper))
    height = points @ np.swapaxes(normal, 1, 2)
    size = np.abs(points) @ np.abs(np.swapaxes(normal, 1, 2))
    ends = [np.abs(np.where(np.isfinite(b), b, 0.0)) for b in (lower, upper)]
    slack = 1e-12 * (size + ends[0] + ends[1])
    return np.asarray(((lower - slack <= height) & (height <= upper + slack)).all(axis=2))


def cut_polygon(center: FloatArray, generators: FloatArray, strips: Strips) -> Polygon:
    """A planar zonotope cut by strips, exactly."""
    polygon = Polygon(planar.zonotope_polygon(center, generators))
    far = 1e3
    for a, lower, upper in zip(strips.normal, strips.lower, strips.upper, strict=True):
        for normal, bound in ((a, upper), (-a, -lower)):
            length = np.linalg.norm(normal)
            if not np.isfinite(bound) or not length:
                continue
            out, foot = normal / length, bound / length**2 * normal
            side = np.array([-out[1], out[0]]) * far
            polygon = polygon.intersection(
                Polygon([foot - side, foot + side, foot + side - 2 * far * out, foot - side - 2 * far * out])
            )
    return polygon


def row(strips: Strips, place: int) -> Strips:
    """The strips of one set."""
    return Strips(
        strips.normal if strips.normal.ndim == 2 else strips.normal[place],
        strips.lower if strips.lower.ndim == 1 else strips.lower[place],
        strips.upper if strips.upper.ndim == 1 else strips.upper[place],
    )
