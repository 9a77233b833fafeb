"""Pictures to go back to, within bounds of time and memory; series."""

from dataclasses import replace

import numpy as np
import pytest

from fleet_dashboard.history import History, Series
from fleet_dashboard.picture import Mark, Picture
from tests.fleet_dashboard.messages import SECOND, T0, of_profile, of_state, of_tube, tube
from tests.fleet_dashboard.test_gateway import fed

TENTH = SECOND // 10


def some(vehicles: int = 1) -> Picture:
    messages = [part for k in range(vehicles) for part in (of_profile(f"v{k}"), of_tube(tube(f"v{k}")))]
    return fed(*messages)[1]


def at(picture: Picture, t: int) -> Picture:
    return replace(picture, t=t)


def test_the_picture_in_force_comes_back() -> None:
    history = History(span=10.0)
    assert history.at(T0) is None
    assert history.span() is None
    kept = [at(some(), T0 + k * TENTH) for k in range(50)]
    for picture in kept:
        assert history.add(picture)
    assert history.at(kept[20].t) is kept[20]
    assert history.at(kept[20].t + TENTH - 1) is kept[20]
    assert history.at(0) is kept[0]
    assert history.at(kept[-1].t + SECOND) is kept[-1]
    assert history.span() == (kept[0].t, kept[-1].t)


def test_what_is_older_than_the_span_goes() -> None:
    history = History(span=2.0)
    for k in range(100):
        history.add(at(some(), T0 + k * TENTH))
    span = history.span()
    assert span is not None
    assert span[1] - span[0] <= 2 * SECOND
    assert span[1] == T0 + 99 * TENTH


def test_within_the_budget_the_span_stays_and_pictures_become_fewer() -> None:
    picture = some(20)
    history = History(span=1000.0, budget=30 * picture.nbytes)
    for k in range(1000):
        history.add(at(picture, T0 + k * TENTH))
        assert history.nbytes <= 30 * picture.nbytes
    span = history.span()
    assert span is not None
    assert span[0] == T0
    assert span[1] >= T0 + 93 * SECOND
    distances = {history.at(T0 + k * SECOND) for k in range(100)}
    assert len(distances) >= 10


def test_pictures_are_not_kept_oftener_than_asked() -> None:
    history = History()
    assert history.add(at(some(), T0))
    assert not history.add(at(some(), T0 + TENTH // 2))
    assert history.add(at(some(), T0 + TENTH))


def test_series_hold_the_newest_figures_in_order() -> None:
    series = Series(length=5)
    assert np.isnan(series.at(T0)["samples"])
    picture = some()
    for k in range(8):
        series.add(replace(at(picture, T0 + k * SECOND), area=np.array([float(k)])), 20.0 + k, 10.0)
    times, fleet = series.fleet()
    assert times.tolist() == [T0 / 1e9 + k for k in range(3, 8)]
    assert fleet[:, Series.FLEET.index("area")].tolist() == [3, 4, 5, 6, 7]
    assert fleet[:, Series.FLEET.index("samples")].tolist() == [23, 24, 25, 26, 27]
    _, own = series.vehicle(0)
    assert own[:, Series.VEHICLE.index("area")].tolist() == [3, 4, 5, 6, 7]
    assert series.at(T0 + 9 * SECOND)["samples"] == 27
    assert series.at(T0 + 4 * SECOND)["samples"] == 24
    assert np.isnan(series.vehicle(10_000)[1]).all()


def test_stale_vehicles_are_gaps_and_not_part_of_means() -> None:
    series = Series()
    picture = replace(some(2), t=T0, area=np.array([1.0, 9.0]), marks=np.array([0, int(Mark.TUBE_OLD)], dtype=np.uint8))
    series.add(picture, 0, 0)
    assert series.fleet()[1][0, Series.FLEET.index("area")] == 1.0
    assert series.fleet()[1][0, Series.FLEET.index("stale")] == 1
    assert np.isnan(series.vehicle(1)[1][0]).all()


def test_the_gateway_counts_what_comes_a_second() -> None:
    gateway, _ = fed(now=T0)
    for k in range(1, 11):
        for n in range(4):
            gateway.feed(of_state("a", [0, k, n, 0], seq=4 * k + n, arrived=T0 + k * TENTH))
        gateway.feed(of_tube(tube("a", seq=4 * k), T0 + k * TENTH))
        gateway.tick(T0 + k * TENTH)
    assert gateway.series.at(T0 + SECOND)["samples"] == pytest.approx(40)
    assert gateway.series.at(T0 + SECOND)["tubes"] == pytest.approx(10)
