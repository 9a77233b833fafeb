"""Slow and obvious twins of planar sets: Shapely polygons."""

import numpy as np
from shapely import MultiPoint, Point, Polygon
from shapely.affinity import translate
from shapely.geometry.base import BaseGeometry

from fleet_lab.paper.formulas import Disc, Formula, Motion, active
from reach_server.numeric.types import FloatArray
from reach_server.sets import ConstrainedZonotope, Zonotope


def hull(center: FloatArray, generators: FloatArray) -> BaseGeometry:
    """The zonotope, one segment after the other."""
    found: BaseGeometry = Point(center)
    for generator in generators.T:
        both = [translate(found, *(sign * generator)) for sign in (1.0, -1.0)]
        found = both[0].union(both[1]).convex_hull
    return found


def outlines(sets: Zonotope | ConstrainedZonotope) -> list[BaseGeometry]:
    """Each set of a batch: zonotopes by their segments, constrained ones as the set library outlines them."""
    if isinstance(sets, Zonotope):
        return [hull(*pair) for pair in zip(sets.center, sets.generators, strict=True)]
    return [MultiPoint(vertices).convex_hull for vertices in sets.polygon()]


def band(normal: FloatArray, middle: float, radius: float, span: float = 100.0) -> Polygon:
    """``|normal·x - middle| <= radius`` as far as ``span`` from the foot of the origin."""
    size = float(np.linalg.norm(normal))
    across = np.array(normal) / size
    along, foot, half = span * np.array([-across[1], across[0]]), across * middle / size, across * radius / size
    return Polygon([foot + along + half, foot - along + half, foot - along - half, foot + along - half])


def half_plane(normal: FloatArray, bound: float, span: float = 100.0) -> Polygon:
    """``normal·x <= bound`` for a unit normal, as far as ``span``."""
    return band(normal, bound - span, span, span)


def tangential(disc: Disc, count: int) -> BaseGeometry:
    """The polygon of ``count`` tangents, the first at the angle 0."""
    angles = 2 * np.pi * np.arange(count) / count
    reach = disc.radius / np.cos(np.pi / count)
    turned = angles + np.pi / count
    return Polygon(disc.center + reach * np.column_stack([np.cos(turned), np.sin(turned)]))


def corners(motion: Motion, position: FloatArray, heading: float) -> FloatArray:
    """The corners 1, 2, 3 and 4 of T(x) as the figure of the paper numbers them, (4, 2)."""
    # Twice the projection of a side on the diagonal is the diagonal.
    side = motion.diagonal / 2 / np.cos(motion.turn)
    ahead = [side * np.array([np.cos(heading + s), np.sin(heading + s)]) for s in (motion.turn, -motion.turn)]
    found: FloatArray = position + np.array([np.zeros(2), ahead[0], ahead[1], ahead[0] + ahead[1]])
    return found


def motion_region(motion: Motion, position: FloatArray, heading: float) -> Polygon:
    """T(x)."""
    return Polygon(corners(motion, position, heading)[[0, 2, 3, 1]])


def regions(formula: Formula, t: float, discs: int = 0) -> list[BaseGeometry]:
    """What strips and discs ask for at ``t``; discs as polygons of ``discs`` tangents, left out where it is 0."""
    moment = np.array([t])
    found: list[BaseGeometry] = [
        band(np.array(strip.normal), strip.middle, strip.radius) for strip in formula.strips if active(strip, moment)[0]
    ]
    if discs:
        found += [tangential(disc, discs) for disc in formula.discs if active(disc, moment)[0]]
    return found
