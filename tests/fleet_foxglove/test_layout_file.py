"""The layout in deploy/foxglove names topics, frames, fields and settings that exist."""

import json
import re
from collections.abc import Iterator
from typing import Any

import pytest
from foxglove import layouts

from fleet_foxglove import topics
from fleet_foxglove.messages import ALL_TOPICS, schema_of
from tests.deploy.units import DEPLOY

LAYOUT = json.loads((DEPLOY / "foxglove" / "fleet.json").read_text(encoding="utf-8"))
PANELS: dict[str, dict[str, Any]] = LAYOUT["configById"]

#: What a file that the application exports calls a panel, and what Foxglove's SDK calls the settings of that panel.
SETTINGS = {
    "3D": layouts.ThreeDeeConfig(),
    "Plot": layouts.PlotConfig(),
    "StateTransitions": layouts.StateTransitionsConfig(),
    "Table": layouts.TableConfig(),
    "RosOut": layouts.LogConfig(),
}
SERIES = {"Plot": layouts.PlotSeries(), "StateTransitions": layouts.StateTransitionsSeries()}
PATH = re.compile(r"(?P<topic>/[\w/]+)(?:\{(?P<field>\w+)==\$(?P<variable>\w+)\})?(?:\.(?P<value>\w+))?")


def kind(panel: str) -> str:
    return panel.partition("!")[0]


def leaves(tree: Any) -> Iterator[str]:
    if isinstance(tree, str):
        yield tree
        return
    assert set(tree) == {"direction", "first", "second", "splitPercentage"}
    assert tree["direction"] in ("row", "column")
    assert 0 < tree["splitPercentage"] < 100
    yield from leaves(tree["first"])
    yield from leaves(tree["second"])


def paths() -> Iterator[str]:
    for panel in PANELS.values():
        yield from (series["value"] for series in panel.get("paths", []))
        yield from (panel[name] for name in ("topicPath", "topicToRender") if name in panel)


def check_path(path: str) -> None:
    """Whether a message path names a topic that is served, fields that its messages have, and a known variable."""
    found = PATH.fullmatch(path)
    assert found is not None, path
    assert found["topic"] in ALL_TOPICS, path
    for name in filter(None, (found["field"], found["value"])):
        assert found["topic"] == topics.NUMBERS, path
        assert name in topics.NUMBERS_SCHEMA["properties"], path
    if found["variable"]:
        assert found["variable"] in LAYOUT["globalVariables"], path


def test_its_panels_are_those_that_are_laid_out() -> None:
    placed = list(leaves(LAYOUT["layout"]))
    assert len(placed) == len(set(placed))
    assert set(placed) == set(PANELS)
    assert {kind(panel) for panel in PANELS} == set(SETTINGS)
    assert set(LAYOUT) == {"configById", "globalVariables", "userNodes", "playbackConfig", "layout"}


@pytest.mark.parametrize("panel", PANELS)
def test_settings_are_those_that_the_panel_has(panel: str) -> None:
    config = PANELS[panel]
    assert set(config) - {"foxglovePanelTitle"} <= set(SETTINGS[kind(panel)]._to_dict())
    for series in config.get("paths", []):
        assert set(series) <= set(SERIES[kind(panel)]._to_dict())


def test_every_path_names_what_is_served() -> None:
    found = list(paths())
    assert len(found) > 8
    for path in found:
        check_path(path)
    used = {match["topic"] for match in map(PATH.fullmatch, found) if match is not None}
    assert used == {topics.NUMBERS, topics.LOG}


@pytest.mark.parametrize(
    "path",
    ["/fleet/number.area", "/fleet/numbers.areas", "/fleet/numbers{vehicle==$car}.area", "fleet/numbers", "/x y"],
)
def test_the_check_of_paths_can_fail(path: str) -> None:
    with pytest.raises(AssertionError):
        check_path(path)


def test_the_scene_shows_every_topic_that_it_can_and_looks_at_the_fleet() -> None:
    scene = PANELS["3D!fleet"]
    drawn = {topic for topic in ALL_TOPICS if schema_of(topic)[0] == "foxglove.SceneUpdate"}
    assert set(scene["topics"]) == drawn
    assert all(topic["visible"] for topic in scene["topics"].values())
    known = set(layouts.BaseRendererSceneUpdateTopicSettings()._to_dict())
    assert all(set(topic) <= known for topic in scene["topics"].values())
    assert scene["followTf"] == topics.FLEET
    (grid,) = scene["layers"].values()
    assert grid["frameId"] == topics.FLEET
    assert set(grid) <= set(layouts.BaseRendererGridLayerSettings()._to_dict())
    assert PANELS["RosOut!events"]["topicToRender"] == topics.LOG
    assert schema_of(topics.LOG)[0] == "foxglove.Log"


def test_plotted_fields_are_numbers_and_transitions_are_texts() -> None:
    properties = topics.NUMBERS_SCHEMA["properties"]
    for panel, config in PANELS.items():
        for series in config.get("paths", []):
            found = PATH.fullmatch(series["value"])
            assert found is not None
            type_ = properties[found["value"]]["type"]
            assert ("number" in type_) if kind(panel) == "Plot" else type_ == "string"
