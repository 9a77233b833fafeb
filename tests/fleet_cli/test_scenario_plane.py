"""Regions on the raster are where their predicates hold."""

import re
from collections.abc import Callable

import numpy as np
import pytest

from fleet_cli.scenario_plane import lay_out
from reach_server.numeric.types import FloatArray
from side_info import Scenario

DOCUMENT = """\
scenario: shapes
version: 1
state: {{x1: m, x2: m, v: m/s}}
time: {{zero: on_start, semantics: sampled}}
regions:
  R: "{region}"
  B: {{box: {{x1: [-2, 2], x2: [-1, 3]}}}}
assume: always[0:1 s](R and B)
"""


def shapes(region: str) -> Scenario:
    return Scenario.parse(DOCUMENT.format(region=region))


@pytest.mark.parametrize(
    ("region", "inside"),
    [
        ("x1 + 2 * x2 <= 1", lambda x, y: x + 2 * y <= 1),
        ("abs(x2 - 1) <= 0.5", lambda x, y: np.abs(y - 1) <= 0.5),
        ("norm(x1, x2 - 1) <= 1", lambda x, y: x**2 + (y - 1) ** 2 <= 1),
        ("norm(x1, x2) >= 1 and x1 >= 0", lambda x, y: (x**2 + y**2 >= 1) & (x >= 0)),
        ("x1 <= -1 or x1 >= 1", lambda x, y: np.abs(x) >= 1),
        ("not (x1 <= -1 or x2 >= 1)", lambda x, y: (x > -1) & (y < 1)),
        ("sin(3 * x1) * exp(-x2) / 2 <= 0.2", lambda x, y: np.sin(3 * x) * np.exp(-y) / 2 <= 0.2),
        ("max(x1, x2) >= 1", lambda x, y: np.maximum(x, y) >= 1),
        ("log(x1) <= 0", lambda x, y: x <= 1),
        ("x1^2 - x2 >= 0.5", lambda x, y: x**2 - y >= 0.5),
        ("2 >= 1", lambda x, y: np.ones_like(x, dtype=bool)),
    ],
)
def test_a_region_is_where_it_holds(region: str, inside: Callable[[FloatArray, FloatArray], FloatArray]) -> None:
    plane, drawn, left_out = lay_out(shapes(region))
    assert plane is not None
    assert left_out == {}
    assert [d.name for d in drawn] == ["R", "B"]
    assert plane.names == ("x1", "x2")
    x, y = np.meshgrid(plane.x, plane.y)
    found, border = drawn[0].margin >= 0, np.abs(drawn[0].margin) < 1e-9
    assert ((found == inside(x, y)) | border).all()


@pytest.mark.parametrize(
    ("region", "reason"),
    [
        ("v >= 0 and x1 >= 0", "it speaks about v"),
        ("x1 * v >= 0", "it speaks about v"),
        ("x1 - last(x1) <= t", r"it moves with (last\(x1\)|t)"),
        ("x1 * exp(-k) <= 3", "it moves with k"),
    ],
)
def test_what_cannot_be_drawn_says_why(region: str, reason: str) -> None:
    _, drawn, left_out = lay_out(shapes(region))
    assert [d.name for d in drawn] == ["B"]
    assert list(left_out) == ["R"]
    assert re.fullmatch(reason, left_out["R"])


def test_the_plane_holds_all_that_is_bounded_and_more_where_a_region_is_open() -> None:
    plane, _, _ = lay_out(shapes("x1 >= 1"))
    assert plane is not None
    assert plane.x[0] == pytest.approx(-2 - 0.12 * 4)
    assert plane.x[-1] == pytest.approx(2 + 0.5 * 4)
    assert (plane.y[0], plane.y[-1]) == (pytest.approx(-1 - 0.12 * 4), pytest.approx(3 + 0.12 * 4))


def test_of_one_state_there_is_no_plane() -> None:
    text = DOCUMENT.format(region="x1 >= 0").replace("x2: m, v: m/s", "").replace(", x2: [-1, 3]", "")
    plane, drawn, left_out = lay_out(Scenario.parse(text))
    assert plane is None
    assert drawn == ()
    assert left_out == {"R": "there is one state only", "B": "there is one state only"}
