"""T(x) as it is meant, against its four corners (Shapely), and as the paper prints it."""

import numpy as np
import pytest

from fleet_lab.paper import cuts
from fleet_lab.paper.cells import Drive
from fleet_lab.paper.cuts import Situation
from fleet_lab.paper.formulas import PHI_THETA, Formula, Motion
from reach_server.sets import Zonotope
from tests.fleet_lab.paper import plane

NOTHING = np.zeros((2, 0))


@pytest.mark.parametrize("heading", [0.0, 0.4, 1.2, np.pi / 2, 2.6, -2.0, np.pi])
def test_the_motion_region_is_the_parallelogram_of_its_corners(heading: float) -> None:
    rng = np.random.default_rng(9)
    for motion in (Motion(), Motion(0.3, 0.1), Motion(0.5, 1.2)):
        last = rng.uniform(-2, 2, 2)
        at = Situation(np.array([1.0]), last[None], np.array([heading]), NOTHING)
        true = plane.motion_region(motion, last, heading)
        everywhere = Zonotope(last[None], 5.0 * np.eye(2)[None])
        only = Formula("motion", "T", 40.0, (), motion=motion)
        (found,) = plane.outlines(cuts.published_constrained(everywhere, only, at, last[None]).sets)
        assert found.symmetric_difference(true).area < 1e-9
        assert found.area == pytest.approx(motion.diagonal**2 * np.tan(motion.turn) / 2)
        assert np.linalg.norm(plane.corners(motion, last, heading)[3] - last) == pytest.approx(motion.diagonal)
        # The two strips, taken alone, hold what lies along them.
        for row in cuts._motion(motion, at):
            assert row.radius == pytest.approx(motion.height / 2)


def test_the_paper_table_has_the_area_of_a_diagonal_of_646_millimetres() -> None:
    heading, last = 0.7, np.zeros(2)
    assert plane.motion_region(Motion(), last, heading).area == pytest.approx(0.076, abs=5e-4)
    sides = 2 * 0.646 * np.cos(np.radians(20))
    assert plane.motion_region(Motion(sides), last, heading).area == pytest.approx(0.268, abs=5e-4)


def test_an_unknown_corner_widens_the_motion_region_by_its_box() -> None:
    """Every position that T(x) allows from any corner in the box is kept; at the border some from one alone."""
    rng, motion, unknown = np.random.default_rng(10), Motion(), np.array([[0.03, 0.01], [-0.01, 0.02]])
    for heading in (0.0, 1.0, 2.5):
        seen = rng.uniform(-1, 1, 2)
        at = Situation(np.array([1.0]), seen[None], np.array([heading]), unknown)
        rows = list(cuts._motion(motion, at))
        least = np.inf
        for beta in (*rng.uniform(-1, 1, (50, 2)), [1, 1], [1, -1], [-1, 1], [-1, -1]):
            for point in plane.corners(motion, seen + unknown @ beta, heading):
                margin = [float(row.radius[0] - abs(row.normal[0] @ point - row.middle[0])) for row in rows]
                assert min(margin) >= -1e-12
                least = min(least, *margin)
        assert least == pytest.approx(0.0, abs=1e-12)


def test_h6_and_h7_are_those_of_the_paper() -> None:
    rng, motion, count = np.random.default_rng(11), Motion(), 500
    heading, last = rng.uniform(-np.pi, np.pi, count), rng.uniform(-2, 2, (count, 2))
    x = last + rng.uniform(-1, 1, (count, 2))
    h6, h7 = cuts.motion_as_printed(motion, Situation(np.ones(count), last, heading, NOTHING))
    for k in range(count):
        (x1, y1), (x2, y2), (x3, y3), _ = plane.corners(motion, last[k], float(heading[k]))
        m1, m2 = (y2 - y1) / (x2 - x1), (y3 - y1) / (x3 - x1)
        c1, c2, c3, c4 = y1 - m1 * x1, y1 - m2 * x1, y2 - m2 * x2, y3 - m1 * x3
        printed = (
            0.5 * abs(c2 - c3) - abs(-m2 * x[k, 0] + x[k, 1] - 0.5 * (c1 + c4)),
            0.5 * abs(c1 - c4) - abs(-m1 * x[k, 0] + x[k, 1] - 0.5 * (c2 + c3)),
        )
        for row, value in zip((h6, h7), printed, strict=True):
            found = row.radius[k] - abs(row.normal[k] @ x[k] - row.middle[k])
            assert found == pytest.approx(value, rel=1e-8, abs=1e-8 * (1 + abs(m1) + abs(m2)))
        # With the centers the other way round they are T(x): its corners lie on both borders.
        for corner in plane.corners(motion, last[k], float(heading[k])):
            scale = 1 + abs(m1) + abs(m2)
            assert 0.5 * abs(c2 - c3) >= abs(-m2 * corner[0] + corner[1] - 0.5 * (c2 + c3)) - 1e-9 * scale
            assert 0.5 * abs(c1 - c4) >= abs(-m1 * corner[0] + corner[1] - 0.5 * (c1 + c4)) - 1e-9 * scale


def test_the_exchanged_centers_are_what_loses_the_vehicle(drives: dict[str, Drive]) -> None:
    """With the centers the other way round the printed rows are the strips of T(x)."""
    drive = drives["phi_theta"]
    motion = Motion()
    h6, h7 = cuts.motion_as_printed(motion, drive.at)
    meant = list(cuts._motion(motion, drive.at))
    for row, middle, strip in ((h6, h7.middle, meant[1]), (h7, h6.middle, meant[0])):
        length = np.hypot(*row.normal.T)
        sign = np.sign((row.normal * strip.normal).sum(axis=1))
        np.testing.assert_allclose(row.radius / length, strip.radius, atol=1e-9)
        np.testing.assert_allclose(sign * middle / length, strip.middle, atol=1e-9)
    lost = ~cuts.printed_motion(drive.sets, PHI_THETA, drive.at, drive.truth).inside
    assert lost.mean() > 0.5
