"""Borders of regions, on a raster and of documents."""

import numpy as np
import pytest

from fleet_bus.messages import ScenarioDocument
from fleet_cli.regions import draw_regions
from fleet_dashboard.regions import Regions, RegionStore, border
from side_info.documents.scenario import Scenario, shipped
from tests.waiting import wait_until

X, Y = np.linspace(-2, 3, 101), np.linspace(-1, 2, 61)
GX, GY = np.meshgrid(X, Y)


def lengths(segments: np.ndarray) -> float:
    return float(np.linalg.norm(segments[:, 1] - segments[:, 0], axis=1).sum())


def test_the_border_of_a_disc_lies_on_its_circle_and_is_closed() -> None:
    segments = border(X, Y, 0.7713 - np.hypot(GX - 0.5, GY - 0.5))
    radii = np.hypot(segments[..., 0] - 0.5, segments[..., 1] - 0.5)
    np.testing.assert_allclose(radii, 0.7713, atol=2e-3)
    assert lengths(segments) == pytest.approx(2 * np.pi * 0.7713, rel=1e-3)
    ends, counts = np.unique(segments.reshape(-1, 2).round(9), axis=0, return_counts=True)
    assert set(counts.tolist()) == {2}
    assert len(ends) == len(segments)


def test_the_border_of_a_half_plane_ends_where_the_raster_ends() -> None:
    segments = border(X, Y, 0.33 - GY)
    np.testing.assert_allclose(segments[..., 1], 0.33)
    assert lengths(segments) == pytest.approx(5.0)


@pytest.mark.parametrize("value", [1.0, -1.0])
def test_what_holds_everywhere_or_nowhere_has_no_border(value: float) -> None:
    assert border(X, Y, np.full_like(GX, value)).shape == (0, 2, 2)


def test_where_two_corners_meet_both_parts_have_a_border() -> None:
    x = y = np.array([0.0, 1.0])
    assert border(x, y, np.array([[1.0, -1.0], [-1.0, 1.0]])).shape == (2, 2, 2)


@pytest.mark.slow
def test_every_shipped_scenario_is_drawn_or_says_why_not() -> None:
    for name in shipped():
        scenario = Scenario.load(name)
        regions = draw_regions(scenario.text)
        assert set(regions.borders) | set(regions.left_out) == set(scenario.regions)
        assert regions.borders.keys() == regions.anchors.keys()
        assert all(regions.left_out.values())


@pytest.mark.slow
def test_the_parking_lot_is_where_its_document_says() -> None:
    regions = draw_regions(Scenario.load("parking-lot").text)
    lot = regions.borders["P"]
    for axis, (low, high) in enumerate([(-1.437, 1.998), (-1.590, 3.268)]):
        assert lot[..., axis].min() == pytest.approx(low, abs=1e-6)
        assert lot[..., axis].max() == pytest.approx(high, abs=1e-6)
    assert regions.predicates["P"] == {"P.x1", "P.x2"}


def document(version: int, text: str = "text", name: str = "lot") -> ScenarioDocument:
    return ScenarioDocument(scenario=name, version=version, text=text)


def test_the_newest_document_counts_and_one_that_cannot_be_drawn_says_so() -> None:
    drawn: list[str] = []

    def draw(text: str) -> Regions:
        drawn.append(text)
        if text == "bad":
            raise ValueError("no scenario")
        return Regions({}, {})

    store = RegionStore(draw)
    for message in (document(2, "two"), document(1, "one"), document(2, "again"), document(3, "bad")):
        store.document(message)
    wait_until(lambda: store.number == 2)
    assert drawn == ["two", "bad"]
    assert store.all() == {}
    assert store.problems() == {"lot": "its regions cannot be drawn: no scenario"}
    store.document(document(4, "good"))
    wait_until(lambda: store.number == 3)
    assert list(store.all()) == ["lot"]
    assert store.problems() == {}


def test_without_what_reads_scenarios_the_page_says_so() -> None:
    store = RegionStore(None)
    store.document(document(1))
    assert "not installed" in store.problems()["lot"]


def test_scenarios_are_bounded() -> None:
    store = RegionStore(lambda text: Regions({}, {}))
    for k in range(100):
        store.document(document(1, name=f"s{k}"))
    wait_until(lambda: store.number == 64)
    assert len(store.all()) == 64
