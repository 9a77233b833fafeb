"""Lines around regions lie where the regions begin."""

import numpy as np
import pytest

from fleet_bus.errors import MessageError
from fleet_bus.messages import ScenarioDocument
from fleet_cli.scenario_outlines import outlines
from fleet_foxglove.scene import Regions
from side_info.documents.scenario import Scenario, shipped
from tests.fleet_bus.messages.examples import reason_or_none

TEXT = """
scenario: lot
version: 1
state: {x: m, y: m, v: m/s}
time: {zero: on_start, semantics: sampled}
regions:
  box: {box: {x: [-1, 3], y: [10, 12]}}
  disc: "1 - norm(x - 5, y - 11) >= 0"
  fast: "v >= 1"
  left: "x <= 0"
assume: always[0:1 s](box)
"""
ONE_STATE = """
scenario: lot
version: 1
state: {x: m}
time: {zero: on_start, semantics: sampled}
regions: {P: "x <= 0"}
assume: always[0:1 s](P)
"""


def drawn(text: str = TEXT) -> Regions:
    return outlines(ScenarioDocument(scenario="lot", version=1, text=text))


def test_lines_are_where_regions_begin_and_what_cannot_be_drawn_is_named() -> None:
    found = drawn()
    assert (found.scenario, found.names) == ("lot", ("x", "y"))
    assert set(found.left_out) == {"fast"}
    by_name = {region.name: region.outlines for region in found.regions}
    assert set(by_name) == {"box", "disc", "left"}
    raster = 0.03
    (box,) = by_name["box"]
    assert len(box) < 30  # corners, not one vertex a point of the raster
    assert np.array_equal(box[0], box[-1])
    x, y = box.T
    away = np.minimum.reduce([np.abs(x + 1), np.abs(x - 3), np.abs(y - 10), np.abs(y - 12)])
    assert away.max() < raster
    assert np.allclose([x.min(), x.max(), y.min(), y.max()], [-1, 3, 10, 12], atol=raster)
    (disc,) = by_name["disc"]
    assert np.allclose(np.hypot(*(disc - [5, 11]).T), 1, atol=1e-3)
    (left,) = by_name["left"]
    assert np.allclose(left[:, 0], 0, atol=1e-9)
    assert len(left) == 2


@pytest.mark.parametrize("name", shipped())
def test_shipped_scenarios_can_be_drawn(name: str) -> None:
    scenario = Scenario.load(name)
    found = outlines(ScenarioDocument(scenario=name, version=1, text=scenario.text))
    assert len(found.names) == 2
    assert {region.name for region in found.regions} | set(found.left_out) == set(scenario.regions)
    assert any(region.outlines for region in found.regions)


def test_one_state_makes_no_plane() -> None:
    found = drawn(ONE_STATE)
    assert found.regions == []
    assert set(found.left_out) == {"P"}


def test_a_text_that_is_no_scenario_is_refused() -> None:
    with pytest.raises(MessageError) as caught:
        drawn("scenario: [")
    assert caught.value.reason == "malformed"


@pytest.mark.parametrize("limit", ["1e308", "1e-308", "1e30"])
def test_extreme_numbers_are_drawn_or_refused(limit: str) -> None:
    text = TEXT.replace("[-1, 3]", f"[-{limit}, {limit}]").replace("[10, 12]", f"[-{limit}, {limit}]")
    refused = reason_or_none(drawn, text)
    assert refused in (None, "range", "malformed")
    if refused is None:
        found = drawn(text)
        assert all(np.isfinite(line).all() for region in found.regions for line in region.outlines)
