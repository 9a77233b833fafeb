"""``fleet watch``, ``fleet top`` and ``fleet events`` of a fleet that runs, as a user and as a program sees them."""

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from typing import Any

import pytest

from fleet_bus.router import Router
from tests.integration.conftest import ROOT, Process, Start, run_fleet
from tests.waiting import DEADLINE, wait_until

pytestmark = pytest.mark.integration

PTY = """
import os, pty, sys
sys.exit(os.waitstatus_to_exitcode(pty.spawn([sys.executable, "-m", "fleet_cli", *sys.argv[1:]])))
"""


@pytest.fixture(scope="module")
def running() -> Iterator[str]:
    """Endpoint of a router with a server, and one vehicle that leaves its scenario."""
    with Router(["tcp/127.0.0.1:0"]) as router:
        at = ("--router", router.endpoints[0])
        processes = []
        try:
            for arguments, ready in (
                (("reach", *at), "ready"),
                (("side-info", "parking-lot", *at), "publishes"),
                (("agent", "--vehicle", "stray", "--route", "roundabout", *at), "agents ready"),
            ):
                processes.append(Process(*arguments))
                processes[-1].expect(ready)
            yield router.endpoints[0]
        finally:
            for process in processes:
                process.end()


def parsed(text: str) -> list[dict[str, Any]]:
    return [json.loads(line, parse_constant=pytest.fail) for line in text.splitlines()]


def test_an_event_is_waited_for_and_then_there(running: str) -> None:
    for _ in range(2):
        done = run_fleet(
            "events", "--count", "1", "--json", "--kind", "contradiction", "--vehicle", "st*", "--router", running
        )
        assert done.returncode == 0, done.stderr
        (event,) = parsed(done.stdout)
        assert event["vehicle"] == "stray"
        assert event["source"] == "reach-1"
        assert event["details"]["predicate"]
    # By the second time it had been told.
    assert event["cached"] is True
    done = run_fleet("events", "--duration", "0", "--since", "1h", "--router", running)
    assert done.returncode == 0, done.stderr
    assert " stray contradiction " in done.stdout
    done = run_fleet("events", "--duration", "0", "--kind", "second_server", "--router", running)
    assert (done.returncode, done.stdout) == (0, "")


def test_watch_says_who_left_the_scenario(running: str, start: Start) -> None:
    process = start("watch", "--json", "--router", running)
    process.expect('"condition": "contradicted"')
    process.expect('"instance": "reach-1"')
    assert process.end() == 0
    lines = parsed("".join(process.lines))
    vehicle = next(line for line in lines if line.get("condition") == "contradicted")
    assert vehicle["vehicle"] == "stray"
    assert vehicle["why"].startswith("contradiction: parking-lot (")
    assert vehicle["server"] == "reach-1"
    assert vehicle["area"] > 0
    assert vehicle["tube_age"] >= 0


def test_one_table_and_the_end(running: str) -> None:
    def shown(command: str, *words: str) -> bool:
        done = run_fleet(command, "--once", "--router", running)
        assert done.returncode == 0, done.stderr
        assert "\x1b" not in done.stdout
        return all(word in done.stdout for word in words)

    # Everything that is awaited comes within the first second, unless the machine is busy.
    wait_until(lambda: shown("watch", "vehicle ", "stray", "reach/reach-1", "contradiction"))
    wait_until(lambda: shown("top", "tubes/s", "stray", "messages/s", "µs a batch"))
    done = run_fleet("watch", "--once", "--vehicle", "bus*", "--router", running)
    assert done.returncode == 0


def test_it_ends_quietly_with_its_reader(running: str) -> None:
    for command in ("watch", "top", "events"):
        process = subprocess.Popen(
            [sys.executable, "-m", "fleet_cli", command, "--json", "--router", running],
            stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=ROOT,
        )  # fmt: skip
        assert process.stdout is not None
        json.loads(process.stdout.readline())
        process.stdout.close()
        assert process.wait(DEADLINE) == 0
        assert process.stderr is not None
        with process.stderr:
            assert process.stderr.read() == ""


def test_on_a_terminal_the_key_q_leaves(running: str) -> None:
    process = subprocess.Popen(
        [sys.executable, "-c", PTY, "watch", "--router", running],
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, cwd=ROOT, env={**os.environ, "TERM": "xterm"},
    )  # fmt: skip
    assert process.stdin is not None
    assert process.stdout is not None
    with process.stdout, process.stdin:
        seen = b""
        while b"stray" not in seen:
            came = os.read(process.stdout.fileno(), 65536)
            assert came, seen.decode(errors="replace")
            seen += came
        # Another screen, and the one before it again when all is over.
        assert b"\x1b[?1049h" in seen
        process.stdin.write(b"q")
        process.stdin.flush()
        seen += process.stdout.read()
        assert b"\x1b[?1049l" in seen
    assert process.wait(DEADLINE) == 0


def test_a_fleet_that_is_not_there(router: Router) -> None:
    done = run_fleet("watch", "--once", "--router", router.endpoints[0])
    assert done.returncode == 0
    assert "no vehicles yet" in done.stdout
    assert "no server is up" in done.stdout
    done = run_fleet("top", "--once", "--json", "--router", router.endpoints[0])
    assert [line["type"] for line in parsed(done.stdout)] == ["total"]


@pytest.mark.parametrize("command", ["watch", "top", "events"])
def test_without_a_router_it_says_so(command: str) -> None:
    done = run_fleet(command, "--json", "--router", "tcp/127.0.0.1:1")
    assert done.returncode == 1
    assert done.stdout == ""
    assert "no router answers at tcp/127.0.0.1:1: start one with `fleet router`" in done.stderr


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["watch", "--sort", "colour"], "label, age, area, coverage, name"),
        (["top", "--sort", "colour"], "bytes, rate, time, age, name"),
        (["events", "--kind", "accident"], "contradiction"),
        (["events", "--since", "yesterday"], "10min"),
        (["events", "--count", "0"], "1"),
        (["watch", "--router", "somewhere"], "endpoint"),
    ],
)
def test_wrong_use_is_told_before_anything_is_waited_for(arguments: list[str], said: str) -> None:
    done = run_fleet(*arguments)
    assert done.returncode == 2, done.stdout + done.stderr
    assert said in done.stderr
    assert "Traceback" not in done.stderr
