"""What ``fleet watch`` and ``fleet top`` show, at fixed widths, of a fleet made of messages; and their JSON lines."""

import json
import re
from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from fleet_bus.errors import UsageError
from fleet_bus.messages import Audit, EventKind, Label
from fleet_cli.live import Moment, Screen
from fleet_cli.terminal import as_text, finite
from fleet_cli.top import TopScreen
from fleet_cli.watch import WatchScreen
from tests.docs.test_docs import page, section
from tests.fleet_bus.messages.examples import T0
from tests.fleet_view.messages import Fleet


def fleet_of_all_sorts() -> Fleet:
    fleet = Fleet()
    fleet.profile("car1")
    fleet.sample("old")
    fleet.tube("old")
    fleet.wait(4.0)
    fleet.tube("car1", notes=(), label=Label.CALIBRATED, audit=Audit(200, 199, 0.1, 200, 199, 4))
    fleet.tube("car2", notes=(), area=np.full(3, 0.123456))
    fleet.tube("stray", notes=(), label=Label.CONTRADICTED)
    fleet.event("stray", kind=EventKind.MISS, message="lay \x1b[31moutside")
    fleet.status(waiting={"new": "its window is not full"})
    fleet.sample("new")
    fleet.wait(0.25)
    return fleet


def drawn(fleet: Fleet, screen: Screen, width: int, height: int | None = None, **moment: Any) -> list[str]:
    found = screen.draw(Moment(fleet.now, T0, **moment), width, height)
    return as_text(found, width=width).splitlines()


@pytest.mark.parametrize("width", [40, 80, 120])
def test_the_worst_stands_first_and_nothing_is_too_wide(width: int) -> None:
    fleet = fleet_of_all_sorts()
    lines = drawn(fleet, WatchScreen(fleet.view), width)
    assert max(map(len, lines)) <= width
    assert lines[0].startswith("5 vehicles: 1 contradicted, 1 stale")
    start = next(i for i, line in enumerate(lines) if line.startswith("vehicle "))
    assert [line.split()[0] for line in lines[start + 1 : start + 6]] == ["stray", "old", "new", "car1", "car2"]
    assert not any("\x1b" in line for line in lines)


def test_a_table_of_120_columns() -> None:
    fleet = fleet_of_all_sorts()
    lines = drawn(fleet, WatchScreen(fleet.view), 120)
    assert lines[0] == "5 vehicles: 1 contradicted, 1 stale, 1 waiting, 1 calibrated, 1 guaranteed"
    assert lines[1] == "services: reach/reach-1"
    head, *rows = (line.split(maxsplit=1) for line in lines[2:8])
    assert head[1].split() == ["label", "age", "sample", "area", "uncut", "coverage", "server", "remark"]
    found = {name: " ".join(rest.split()) for name, rest in rows}
    assert found["stray"] == ("contradicted 0.25 s – 1 2 90 % reach-1 miss: lay \N{REPLACEMENT CHARACTER}[31moutside")
    assert found["old"] == "guaranteed stale 4 s 4.25 s 1 2 90 / 100 % reach-1 no samples come; rank deficient"
    assert found["new"] == "no tube – 0.25 s – – – – waits: its window is not full"
    assert found["car1"] == "calibrated 0.25 s – 1 2 99.5 / 99 % reach-1"
    assert found["car2"] == "guaranteed 0.25 s – 0.123 2 90 / 100 % reach-1"
    assert lines[8] == "events"
    assert lines[9].split(maxsplit=1)[1] == "stray miss lay \N{REPLACEMENT CHARACTER}[31moutside"
    assert len(lines) == 10


def test_a_table_of_80_columns_keeps_what_matters() -> None:
    fleet = fleet_of_all_sorts()
    lines = drawn(fleet, WatchScreen(fleet.view), 80)
    (head,) = (line for line in lines if line.startswith("vehicle "))
    assert head.split() == ["vehicle", "label", "age", "area", "coverage", "remark"]
    assert any("stale 4 s" in line for line in lines)
    assert any("waits: its window is not full" in line for line in lines)


def test_colours_are_for_terminals(monkeypatch: pytest.MonkeyPatch) -> None:
    fleet = fleet_of_all_sorts()
    monkeypatch.setenv("TERM", "xterm-256color")
    monkeypatch.delenv("NO_COLOR", raising=False)
    found = as_text(WatchScreen(fleet.view).draw(Moment(fleet.now, T0), 120, None), width=120, terminal=True)
    (stray,) = (line for line in found.splitlines() if "contradicted" in line and "stray" in line)
    assert stray.startswith("\x1b[31m")
    (old,) = (line for line in found.splitlines() if "stale 4 s" in line)
    assert old.startswith("\x1b[2m")


def test_only_some_vehicles_in_another_order() -> None:
    fleet = fleet_of_all_sorts()
    lines = drawn(fleet, WatchScreen(fleet.view, sort="name", only="car*"), 120)
    assert lines[0] == "2 vehicles: 1 calibrated, 1 guaranteed"
    assert [line.split()[0] for line in lines[3:]] == ["car1", "car2"]
    assert drawn(fleet, WatchScreen(fleet.view, only="bus*"), 120)[0] == "none of 5 vehicles is called bus*"
    with pytest.raises(UsageError, match="label, age, area, coverage, name"):
        WatchScreen(fleet.view, sort="colour")
    with pytest.raises(UsageError, match="bytes, rate, time, age, name"):
        TopScreen(fleet.view, sort="colour")


@pytest.mark.parametrize("height", [8, 12, 24])
@pytest.mark.parametrize("make", [WatchScreen, TopScreen])
def test_of_too_many_vehicles_the_first_are_shown_and_how_many_are_not(make: Any, height: int) -> None:
    fleet = Fleet()
    fleet.status()
    for i in range(50):
        fleet.tube(f"car{i}", label=Label.CONTRADICTED if i == 37 else Label.GUARANTEED)
        fleet.event(f"car{i}", kind=EventKind.JUMP)
    lines = drawn(fleet, make(fleet.view), 100, height)
    assert len(lines) <= height
    shown = [line.split()[0] for line in lines if line.startswith("car")]
    assert f"… and {50 - len(shown)} more vehicles" in lines
    if make is WatchScreen:
        assert shown[0] == "car37"
        assert ("events" in lines) == (height > 8)


def test_what_is_not_there_is_said() -> None:
    fleet = Fleet()
    lines = drawn(fleet, WatchScreen(fleet.view), 80)
    assert lines[0].startswith("no vehicles yet")
    assert lines[1].startswith("no server is up")
    assert drawn(fleet, TopScreen(fleet.view), 80)[-1].startswith("no vehicles yet")
    fleet.status()
    assert not any("no server" in line for line in drawn(fleet, WatchScreen(fleet.view), 80))
    fleet.wait(4.0)
    lines = drawn(fleet, WatchScreen(fleet.view), 80)
    assert lines[1].startswith("no server is up")
    assert lines[2] == "services: reach/reach-1 stale 4 s"
    for screen in (WatchScreen(fleet.view), TopScreen(fleet.view)):
        assert drawn(fleet, screen, 80, lost=("tcp/a:1",))[0].startswith("no router answers at tcp/a:1")


def test_problems_and_what_cannot_be_read_are_said() -> None:
    fleet = Fleet()
    fleet.status(problems=["the server publishes tubes late"], gauges={"waiting": 130.0}, waiting={"a": "no profile"})
    fleet.put("reach/a/tube", b"", "application/msgpack;fleet.tube.v9")
    fleet.view.skip(3)
    lines = drawn(fleet, WatchScreen(fleet.view), 200)
    assert "services: reach/reach-1 (129 more wait than it names)" in lines
    assert "reach/reach-1: the server publishes tubes late" in lines
    (line,) = (line for line in lines if line.startswith("1 refused (version)"))
    assert line.endswith("'application/msgpack;fleet.tube.v9' came, this program reads version 1")
    assert "reach/a/tube" in line
    assert "3 tubes not looked at: newer ones had come" in lines


def test_what_each_vehicle_costs() -> None:
    fleet = Fleet()
    for _ in range(100):
        fleet.wait(0.1)
        seconds = fleet.now / 1e4
        for vehicle in ("car1", "car2"):
            fleet.tube(vehicle, compute_seconds=seconds)
        fleet.sample("car1")
    lines = drawn(fleet, TopScreen(fleet.view, sort="name"), 120)
    figures = {line.split()[0]: line.split() for line in lines if line.startswith("car")}
    assert figures["car1"][1] == figures["car1"][2] == "10.1"
    assert figures["car2"][1] == "0.0"
    # 110 s / 1e4, for two tubes.
    assert figures["car1"][-6:-1] == [*figures["car2"][-6:-4], *figures["car2"][-4:-1]]
    assert "11000" in figures["car1"]
    assert "5500" in figures["car1"]
    assert lines[0].startswith("bus: 30.3 messages/s")
    assert "300 messages" in lines[0]
    assert any(line.startswith("server reach-1: ") and "a batch of 2 tubes" in line for line in lines)
    assert [line.split()[0] for line in drawn(fleet, TopScreen(fleet.view), 80) if line.startswith("car")] == [
        "car1", "car2"
    ]  # fmt: skip


def documented(command: str) -> dict[str, set[str]]:
    """By type the keys of the JSON lines of a command, as its page says."""
    text = section(page("reference/command.md"), command)
    rows = re.findall(r"^\| `(fleet|service|vehicle|event|total|kind|server)` \| (.*) \|$", text, re.M)
    return {name: set(re.findall(r"`(\w+)`", re.sub(r"\([^)]*\)", "", keys))) for name, keys in rows}


def parsed(lines: Iterable[Mapping[str, Any]]) -> list[dict[str, Any]]:
    return [json.loads(json.dumps(finite(line), allow_nan=False)) for line in lines]


def test_the_json_lines_of_watch_hold_the_documented_keys() -> None:
    fleet = fleet_of_all_sorts()
    screen = WatchScreen(fleet.view)
    lines = parsed(screen.lines(Moment(fleet.now, T0)))
    wanted = documented("fleet watch")
    for line in lines:
        if line["type"] != "event":
            assert set(line) == {"type", "t"} | wanted[line["type"]]
    assert [line["type"] for line in lines] == ["fleet", "service", *["vehicle"] * 5, "event"]
    assert lines[0]["conditions"] == {"contradicted": 1, "stale": 1, "waiting": 1, "calibrated": 1, "guaranteed": 1}
    assert (lines[0]["servers"], lines[0]["router"]) == (1, True)
    assert lines[2]["vehicle"] == "stray"
    assert lines[4]["label"] is None
    assert lines[4]["tube_age"] is None
    # An event is told once.
    assert parsed(screen.lines(Moment(fleet.now, T0)))[-1]["type"] == "vehicle"
    fleet.event("car1")
    fleet.event(None, kind=EventKind.BEHIND)
    assert [line["vehicle"] for line in parsed(screen.lines(Moment(fleet.now, T0))) if line["type"] == "event"] == [
        "car1", None
    ]  # fmt: skip
    only = parsed(WatchScreen(fleet.view, only="car1").lines(Moment(fleet.now, T0)))
    assert [line["vehicle"] for line in only if line["type"] in ("vehicle", "event")] == ["car1", "car1"]


def test_the_json_lines_of_top_hold_the_documented_keys() -> None:
    fleet = fleet_of_all_sorts()
    lines = parsed(TopScreen(fleet.view).lines(replace(Moment(fleet.now, T0), lost=("tcp/a:1",))))
    wanted = documented("fleet top")
    assert {line["type"] for line in lines} == set(wanted)
    for line in lines:
        assert set(line) == {"type", "t"} | wanted[line["type"]]
    assert lines[0]["router"] is False
    assert lines[0]["messages"] == 9
    assert sum(line["messages"] for line in lines if line["type"] == "kind") == 9
    assert sum(line["bytes"] for line in lines if line["type"] == "kind") == lines[0]["bytes"]
    (new,) = (line for line in lines if line.get("vehicle") == "new")
    assert new["bytes_per_tube"] is None
