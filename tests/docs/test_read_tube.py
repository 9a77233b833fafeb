"""The example of the guide, run against a router."""

import subprocess
import sys
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from pathlib import Path

import pytest

from fleet_bus import Role, keys, open_session
from fleet_bus.messages.tube import ENCODING
from fleet_bus.pubsub import declare_cached_publisher
from fleet_bus.router import Router
from tests.fleet_bus.messages.examples import a_tube
from tests.waiting import DEADLINE, wait_until

pytestmark = pytest.mark.integration

EXAMPLE = Path(__file__).parents[2] / "docs" / "examples" / "read_tube.py"
SVG = "{http://www.w3.org/2000/svg}"


@pytest.fixture(scope="module")
def router() -> Iterator[str]:
    with Router(["tcp/127.0.0.1:0"]) as running:
        yield running.endpoints[0]


def start(*arguments: str, at: Path) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, str(EXAMPLE), *arguments], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=at
    )


def test_it_draws_the_tubes_that_come_and_no_others(router: str, tmp_path: Path) -> None:
    wanted = a_tube(vehicle="svea1", center=a_tube().center * 0.1)
    with open_session(Role.SERVICE, [router]) as session:
        publishers = [
            (declare_cached_publisher(session, keys.tube("svea1"), ENCODING, cache=1), wanted.encode()),
            (
                declare_cached_publisher(session, keys.tube("svea2"), ENCODING, cache=1),
                a_tube(vehicle="svea2").encode(),
            ),
            (declare_cached_publisher(session, keys.tube("svea1"), "application/json", cache=1), b"{}"),
        ]
        reader = start("--router", router, "--vehicle", "svea1", "--count", "2", "--output", "t.svg", at=tmp_path)

        def put() -> None:
            for publisher, payload in publishers:
                publisher.put(payload)

        wait_until(lambda: reader.poll() is not None, 20, meanwhile=put)
        for publisher, _ in publishers:
            publisher.close()
    out, errors = reader.communicate()
    assert (reader.returncode, errors) == (0, "")
    assert "2 of 2 tubes drawn in t.svg" in out
    assert out.startswith("svea1 seq 7: guaranteed, 0.15 s ahead, area 1\n")
    root = ET.parse(tmp_path / "t.svg").getroot()
    polygons = root.findall(f"{SVG}polygon")
    assert len(polygons) == 2 * len(wanted.times)
    assert all(len((polygon.get("points") or "").split()) == 4 for polygon in polygons)


def test_it_reads_the_numbers_that_were_put() -> None:
    names: dict[str, object] = {"__name__": "example"}
    exec(EXAMPLE.read_text(encoding="utf-8"), names)
    tube = a_tube()
    found = names["read_tube"](tube.encode())  # type: ignore[operator]
    assert (found["vehicle"], found["t"], found["label"], found["axes"]) == ("svea1", tube.t, "guaranteed", ("x", "y"))
    for k, step in enumerate(found["steps"]):
        assert step["time"] == tube.times[k]
        assert step["area"] == tube.area[k]
        assert step["outline"] == [tuple(tube.center[k, :2] + vertex) for vertex in tube.outline[k]]


def test_it_says_so_when_no_tube_comes(router: str, tmp_path: Path) -> None:
    reader = start("--router", router, "--timeout", "0.2", at=tmp_path)
    _, errors = reader.communicate(timeout=DEADLINE)
    assert reader.returncode == 1
    assert "no tube on reach/*/tube within 0.2 s" in errors
    assert not list(tmp_path.iterdir())


def test_it_says_so_when_there_is_no_router(tmp_path: Path) -> None:
    with Router(["tcp/127.0.0.1:0"]) as closed:
        nowhere = closed.endpoints[0]
    reader = start("--router", nowhere, "--timeout", "1", at=tmp_path)
    _, errors = reader.communicate(timeout=DEADLINE)
    assert reader.returncode == 1
    assert f"no connection to the router {nowhere}" in errors


def test_wrong_use_is_refused(tmp_path: Path) -> None:
    reader = start("--count", "0", at=tmp_path)
    _, errors = reader.communicate(timeout=DEADLINE)
    assert reader.returncode == 2
    assert "must be positive" in errors
