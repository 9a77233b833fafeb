"""The cuts against a plain transcription of Algorithm 2 and polygon clipping (Shapely)."""

from functools import reduce

import numpy as np
import pytest
from scipy.optimize import minimize
from shapely import Point
from shapely.geometry.base import BaseGeometry

from fleet_lab.paper import cuts
from fleet_lab.paper.cells import Cut, Drive
from fleet_lab.paper.cuts import Situation
from fleet_lab.paper.formulas import FORMULAS, PHI_R, Disc, Formula, active
from fleet_lab.paper.study import OURS, Study
from reach_server.numeric.types import FloatArray
from reach_server.sets import Zonotope
from tests.fleet_lab.paper import plane

NOTHING = np.zeros((2, 0))


def area(generators: FloatArray) -> float:
    """Of a planar zonotope: 4 Σ |det|."""
    dets = np.linalg.det(np.stack(np.broadcast_arrays(generators.T[:, None], generators.T[None]), axis=-1))
    return float(2 * np.abs(dets).sum())


def least(generators: FloatArray, J: FloatArray, r: float, remainder: float) -> FloatArray:
    """Line 4: the λ of least Frobenius norm, numerically."""

    def norm(gain: FloatArray) -> float:
        kept = generators - np.outer(gain, J @ generators)
        return float((kept**2).sum() + (gain**2).sum() * (r**2 + remainder**2))

    return np.asarray(minimize(norm, np.zeros(2), method="BFGS", options={"gtol": 1e-9}).x)


def line_7_and_8(
    center: FloatArray, generators: FloatArray, H: FloatArray, y: float, r: float
) -> tuple[FloatArray, FloatArray]:
    gain = least(generators, H, r, 0.0)
    kept = (np.eye(2) - np.outer(gain, H)) @ generators
    return center + gain * (y - H @ center), np.column_stack([kept, gain * r])


def line_11_and_12(
    center: FloatArray, generators: FloatArray, disc: Disc, remainder: float
) -> tuple[FloatArray, FloatArray]:
    """``h(x) = |x - q|`` linearised at the center; where the remainder is infinite nothing can be said."""
    if not np.isfinite(remainder):
        return center, generators
    h, J = np.linalg.norm(center - disc.center), (center - disc.center) / np.linalg.norm(center - disc.center)
    gain = least(generators, J, disc.radius, remainder)
    kept = (np.eye(2) - np.outer(gain, J)) @ generators
    return center - gain * h, np.column_stack([kept, gain * disc.radius, -gain * remainder])


def lagrange(disc: Disc, center: FloatArray, generators: FloatArray) -> float:
    """A bound of what ``|x - q|`` differs by from its linearisation on the hull of a set, from the interval Hessian."""
    low, high = center - np.abs(generators).sum(axis=1), center + np.abs(generators).sum(axis=1)
    nearest = float(np.linalg.norm(np.clip(disc.center, low, high) - disc.center))
    if nearest == 0.0:
        return float("inf")
    d = high - center
    hessian = np.array([[1.0, 0.5], [0.5, 1.0]]) / nearest
    return float(d @ hessian @ d / 2)


def plain_algorithm_2(drive: Drive, formula: Formula, step: int, *, remainder: bool) -> tuple[FloatArray, FloatArray]:
    center, generators = drive.sets.center[step], drive.sets.generators[step]
    moment = drive.at.t[step : step + 1]
    for strip in formula.strips:
        if active(strip, moment)[0]:
            center, generators = line_7_and_8(center, generators, np.array(strip.normal), strip.middle, strip.radius)
    for disc in formula.discs:
        if active(disc, moment)[0]:
            beyond = lagrange(disc, center, generators) if remainder else 0.0
            center, generators = line_11_and_12(center, generators, disc, beyond)
    if formula.motion is not None:
        one, two, three, _ = plane.corners(formula.motion, drive.at.last[step], float(drive.at.heading[step]))
        for corner, opposite in ((two, three), (three, two)):
            # Between the side from corner 1 and the one from the opposite corner, with a normal of any length.
            H = np.array([[0.0, -1.0], [1.0, 0.0]]) @ (corner - one)
            ends = H @ one, H @ opposite
            center, generators = line_7_and_8(center, generators, H, sum(ends) / 2, abs(ends[1] - ends[0]) / 2)
    return center, generators


@pytest.mark.parametrize("formula", FORMULAS, ids=lambda formula: formula.key)
@pytest.mark.parametrize("remainder", [False, True])
@pytest.mark.slow
def test_algorithm_2_line_by_line(drives: dict[str, Drive], formula: Formula, remainder: bool) -> None:
    drive = drives[formula.key]
    found = cuts.published_zonotopes(drive.sets, formula, drive.at, drive.truth, remainder=remainder)
    assert isinstance(found.sets, Zonotope)
    changed = 0
    for step in range(len(drive.truth)):
        center, generators = plain_algorithm_2(drive, formula, step, remainder=remainder)
        np.testing.assert_allclose(found.sets.center[step], center, atol=1e-6)
        assert found.sets.area()[step] == pytest.approx(area(generators), rel=1e-6)
        theirs = found.sets.generators[step]
        for angle in np.linspace(0.0, np.pi, 12):
            direction = np.array([np.cos(angle), np.sin(angle)])
            assert np.abs(direction @ theirs).sum() == pytest.approx(np.abs(direction @ generators).sum(), rel=1e-6)
        changed += area(generators) != pytest.approx(area(drive.sets.generators[step]), rel=1e-3)
    # The remainder is infinite for a set that holds the center of the disc, as all do: only the strips cut.
    assert changed == (8 if remainder and formula is PHI_R else len(drive.truth))


def test_algorithm_2_makes_sets_larger_and_does_not_look_where_they_are(study: Study) -> None:
    """Areas of the phases of φ_p [paper.md §2], at any center."""
    rng = np.random.default_rng(0)
    t = np.array([1.0, 24.5, 30.0])
    hexagon = np.array([[0.9, 0.0, 0.9], [0.0, 0.9, 0.9]])
    for _ in range(3):
        centers = rng.uniform(-9, 9, (3, 2))
        sets = Zonotope(centers, np.broadcast_to(hexagon, (3, 2, 3)))
        at = Situation(t, centers, np.zeros(3), NOTHING)
        areas = cuts.published_zonotopes(sets, FORMULAS[0], at, centers).sets.area()
        np.testing.assert_allclose(areas, [11.979, 4.219, 8.162], atol=0.02)


def clipped(drive: Drive, step: int, formula: Formula, *others: BaseGeometry, discs: int = 0) -> BaseGeometry:
    """The set of a step, clipped by what the formula asks for then and by ``others``."""
    found = plane.hull(drive.sets.center[step], drive.sets.generators[step])
    asked = plane.regions(formula, float(drive.at.t[step]), discs)
    if formula.motion is not None:
        asked.append(plane.motion_region(formula.motion, drive.at.last[step], float(drive.at.heading[step])))
    return reduce(lambda left, right: left.intersection(right), [*asked, *others], found)


@pytest.mark.parametrize("formula", FORMULAS, ids=lambda formula: formula.key)
def test_algorithm_3_is_polygon_clipping(drives: dict[str, Drive], formula: Formula) -> None:
    drive = drives[formula.key]
    areas = cuts.published_constrained(drive.sets, formula, drive.at, drive.truth).sets.area()
    for step in range(len(drive.truth)):
        linear = []
        for disc in formula.discs:
            if active(disc, drive.at.t[step : step + 1])[0]:
                center = drive.sets.center[step]
                distance = float(np.linalg.norm(center - disc.center))
                J = (center - disc.center) / distance
                # |h(x*) + J (x - x*)| <= r
                linear.append(plane.band(J, float(J @ center) - distance, disc.radius))
        assert areas[step] == pytest.approx(clipped(drive, step, formula, *linear).area, rel=1e-8)


@pytest.mark.parametrize("formula", FORMULAS, ids=lambda formula: formula.key)
def test_ours_is_polygon_clipping_by_tangents(drives: dict[str, Drive], formula: Formula) -> None:
    drive = drives[formula.key]
    areas = cuts.our_constrained(drive.sets, formula, drive.at, drive.truth).sets.area()
    around = cuts.our_zonotopes(drive.sets, formula, drive.at, drive.truth).sets.area()
    for step in range(len(drive.truth)):
        found, round_one = (clipped(drive, step, formula, discs=count).area for count in (16, 512))
        assert areas[step] == pytest.approx(found, rel=1e-8)
        round_off = sum(0.0131 * np.pi * disc.radius**2 for disc in formula.discs)
        assert round_one * (1 - 1e-8) <= areas[step] <= round_one * (1 + 1e-8) + round_off
        assert areas[step] <= around[step] * (1 + 1e-9)
        assert around[step] <= area(drive.sets.generators[step]) * (1 + 1e-9)


def test_the_linearised_disc_with_its_remainder_is_clipping_by_a_wider_strip() -> None:
    """Sets beside the disc's center, where the remainder is finite."""
    (disc,), centers = PHI_R.discs, np.array([[3.0, 0.3], [-2.4, 2.0], [0.3, -2.9]])
    generators = np.broadcast_to(np.array([[0.4, 0.1, 0.2], [0.0, 0.5, 0.3]]), (3, 2, 3))
    drive = Drive(Zonotope(centers, generators), Situation(np.full(3, 7.0), centers, np.zeros(3), NOTHING), centers)
    areas = cuts.published_constrained(drive.sets, PHI_R, drive.at, drive.truth, remainder=True).sets.area()
    zonotopes = cuts.published_zonotopes(drive.sets, PHI_R, drive.at, drive.truth, remainder=True).sets.area()
    for step, center in enumerate(centers):
        beyond = lagrange(disc, center, generators[step])
        assert np.isfinite(beyond)
        distance = float(np.linalg.norm(center - disc.center))
        J = (center - disc.center) / distance
        strip = plane.band(J, float(J @ center) - distance, disc.radius + beyond)
        assert areas[step] == pytest.approx(clipped(drive, step, PHI_R, strip).area, rel=1e-8)
        assert areas[step] < 0.999 * area(generators[step])
        assert zonotopes[step] == pytest.approx(
            area(plain_algorithm_2(drive, PHI_R, step, remainder=True)[1]), rel=1e-6
        )


def test_the_remainder_bounds_what_a_linearisation_leaves() -> None:
    rng, (disc,) = np.random.default_rng(1), PHI_R.discs
    count = 300
    centers = disc.center + rng.uniform(-1.5, 1.5, (count, 2))
    generators = rng.normal(size=(count, 2, 4)) * rng.uniform(0.01, 0.4, (count, 1, 1))
    sets = Zonotope(centers, generators)
    row = cuts._linearised(disc, sets, np.full(count, 7.0), True)
    bare = cuts._linearised(disc, sets, np.full(count, 7.0), False)
    np.testing.assert_array_equal(bare.widened, disc.radius)
    share = np.zeros(count)
    for _ in range(400):
        beta = rng.uniform(-1, 1, (count, 4, 1))
        beta = np.where(rng.random((count, 1, 1)) < 0.5, np.sign(beta), beta)
        x = centers + (generators @ beta)[..., 0]
        left = np.abs(np.hypot(*(x - disc.center).T) - (np.sum(row.normal * x, axis=1) - row.middle))
        assert (left <= np.asarray(row.remainder) + 1e-12).all()
        share = np.maximum(share, left / row.remainder)
    reach = np.abs(generators).sum(axis=-1)
    holds_center = (np.abs(centers - disc.center) <= reach).all(axis=1)
    np.testing.assert_array_equal(np.isinf(row.remainder), holds_center)
    assert 20 < holds_center.sum() < count - 20
    # A bound that says something: for some it is nearly reached.
    assert share.max() > 0.4


def test_tangents_touch_the_disc_and_leave_it_inside() -> None:
    (disc,) = PHI_R.discs
    t = np.array([3.98, 4.0, 7.0, 10.0, 10.02])
    rows = list(cuts._tangents(disc, t))
    assert len(rows) == 8
    around = np.linspace(0, 2 * np.pi, 1000)
    border = disc.center + disc.radius * np.column_stack([np.cos(around), np.sin(around)])
    for row in rows:
        np.testing.assert_array_equal(np.isfinite(row.radius), [False, True, True, True, False])
        offset = np.abs(border @ row.normal[2] - row.middle[2])
        assert offset.max() <= row.radius[2]
        assert offset.max() >= row.radius[2] - 1e-4
    # Evenly spread.
    angles = np.sort([np.arctan2(*row.normal[2][::-1]) % np.pi for row in rows])
    np.testing.assert_allclose(np.diff(angles), np.pi / 8, atol=1e-9)


@pytest.mark.parametrize("cut", [cuts.published_zonotopes, cuts.our_zonotopes, cuts.published_constrained,
                                 cuts.our_constrained])  # fmt: skip
@pytest.mark.parametrize("formula", FORMULAS, ids=lambda formula: formula.key)
def test_no_cut_loses_a_point_that_obeys(drives: dict[str, Drive], formula: Formula, cut: Cut) -> None:
    """Not only where vehicles were: any point of a set that the formula allows stays in it."""
    rng, drive, kept = np.random.default_rng(5), drives[formula.key], 0
    count = len(drive.truth)
    for _ in range(150):
        if formula.motion is None:
            beta = rng.uniform(-1, 1, (count, 3, 1))
            points = drive.sets.center + (drive.sets.generators @ beta)[..., 0]
        else:
            shares = rng.uniform(0, 1, (count, 2))
            four = [plane.corners(formula.motion, *pose) for pose in zip(drive.at.last, drive.at.heading, strict=True)]
            points = np.array([c[0] + s[0] * (c[1] - c[0]) + s[1] * (c[2] - c[0])
                               for c, s in zip(four, shares, strict=True)])  # fmt: skip
        obeys = (formula.clearance(drive.at.t, points) >= 0.0) & cuts.holds(drive.sets, points)
        assert cut(drive.sets, formula, drive.at, points).inside[obeys].all()
        kept += int(obeys.sum())
    assert kept > 50 * count


@pytest.mark.parametrize("formula", FORMULAS, ids=lambda formula: formula.key)
def test_what_is_inside_is_inside_of_the_polygon(drives: dict[str, Drive], formula: Formula) -> None:
    rng, drive = np.random.default_rng(6), drives[formula.key]
    seen = set()
    for spread in (0.1, 0.5, 1.5):
        points = drive.truth + rng.uniform(-spread, spread, drive.truth.shape)
        for cut in (cuts.published_zonotopes, cuts.published_constrained, *OURS.values()):
            found = cut(drive.sets, formula, drive.at, points)
            for polygon, point, inside in zip(plane.outlines(found.sets), points, found.inside, strict=True):
                if polygon.exterior.distance(Point(point)) > 1e-6:
                    assert inside == polygon.contains(Point(point))
                    seen.add(bool(inside))
    assert seen == {True, False}
