"""A set cut by a disc: tangents, and the paper's symmetric strip."""

import numpy as np
from shapely import Point, Polygon

from benchmarks.report import Cell, Claim, Table
from reach_server.predicates import tangents
from reach_server.sets import ConstrainedZonotope, Zonotope
from reach_server.sets import polygon as planar

RADIUS = 1.2


def run(quick: bool) -> Table:
    """Area of one zonotope inside a disc around the origin, exact and as it is cut."""
    center, generators = np.array([0.3, 0.2]), np.array([[1.5, 0.3, -0.4], [0.2, 1.1, 0.6]])
    around = planar.zonotope_polygon(np.zeros(2), 4 * RADIUS * np.eye(2))
    for normal, bound in zip(*tangents(np.zeros(2), RADIUS), strict=True):
        around = planar.clip(around, normal, np.array(bound))
    disc = np.pi * RADIUS**2
    vertices = planar.zonotope_polygon(center, generators)
    whole = Polygon(vertices)
    exact = whole.intersection(Point(0, 0).buffer(RADIUS, 64 if quick else 1024)).area
    for normal, bound in zip(*tangents(np.zeros(2), RADIUS), strict=True):
        vertices = planar.clip(vertices, normal, np.array(bound))
    tangent = float(planar.polygon_area(vertices))
    # h = r² - |x|² with |h| <= r², at the center, and the remainder of h over the box of the set.
    corner = np.abs(generators).sum(axis=1)
    strip = -2 * center, RADIUS**2 - center @ center, (-(corner @ corner), 0.0), RADIUS**2
    printed = Zonotope(center, generators).intersect_linearised(*strip, method="frobenius").area()
    constrained = ConstrainedZonotope.from_zonotope(Zonotope(center, generators)).intersect_linearised(*strip).area()
    areas = (
        ("the set, not cut", whole.area), ("its part in the disc, exact", exact), ("16 tangents", tangent),
        ("the paper's symmetric strip, Algorithm 2", float(printed)),
        ("the paper's symmetric strip, Algorithm 3", float(constrained)),
    )  # fmt: skip
    rows: list[tuple[Cell, ...]] = [(name, area, area / exact) for name, area in areas]
    whole_disc = float(planar.polygon_area(around))
    rows.append(("16 tangents, without a set: over the disc", whole_disc, whole_disc / disc))
    return Table(
        "A disc",
        f"One planar zonotope of three generators, {RADIUS} m around the origin. The paper's strip takes h from both "
        "sides and linearises it once, with its remainder; tangents need none, since h is concave.",
        ("cut by", "area", "over the exact one"),
        rows,
        [Claim("disc cut by 16 tangents: area over the exact intersection", tangent / exact, "≤", 1.02)],
    )
