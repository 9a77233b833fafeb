"""Real processes over a router in this one."""

import json
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any

import pytest

from fleet_bus.router import Router
from reach_server.service.server import ReachServer
from tests.waiting import DEADLINE

ROOT = Path(__file__).resolve().parents[2]
RECORDINGS = ROOT / "tests" / "data" / "recordings"

Start = Callable[..., "Process"]


class Process:
    """A running ``fleet …`` whose output can be waited for."""

    def __init__(self, *arguments: str) -> None:
        self.process = subprocess.Popen(
            [sys.executable, "-m", "fleet_cli", *arguments],
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            cwd=ROOT,
        )
        self.lines: list[str] = []
        self._new_line = threading.Condition()
        assert self.process.stdout is not None
        threading.Thread(target=self._read, args=(self.process.stdout,), daemon=True).start()

    def _read(self, stream: IO[str]) -> None:
        with stream:
            for line in stream:
                with self._new_line:
                    self.lines.append(line)
                    self._new_line.notify_all()

    def expect(self, text: str, timeout: float = DEADLINE) -> None:
        """Wait for a line of output that holds ``text``."""
        with self._new_line:
            found = self._new_line.wait_for(lambda: any(text in line for line in self.lines), timeout)
        assert found, f"no {text!r} in: {''.join(self.lines)}"

    def end(self) -> int:
        """Ask the process to end; its exit code."""
        if self.process.poll() is None:
            self.process.terminate()
        try:
            return self.process.wait(DEADLINE)
        except subprocess.TimeoutExpired:
            self.process.kill()
            raise


@pytest.fixture
def router() -> Iterator[Router]:
    """A router on a free port."""
    with Router(["tcp/127.0.0.1:0"]) as running:
        yield running


@pytest.fixture
def start() -> Iterator[Start]:
    """Starts ``fleet …`` processes, which are ended after the test."""
    started: list[Process] = []

    def begin(*arguments: str) -> Process:
        process = Process(*arguments)
        started.append(process)
        return process

    yield begin
    for process in started:
        if process.process.poll() is None:
            process.process.kill()
            process.process.wait(DEADLINE)


@contextmanager
def serving(endpoint: str, instance: str = "reach-test") -> Iterator[ReachServer]:
    """A reach server in a thread of this process, so that a test can look into its windows."""
    stop = threading.Event()
    with ReachServer(instance, [endpoint]) as server:
        thread = threading.Thread(target=server.run, args=(stop,))
        thread.start()
        try:
            yield server
        finally:
            stop.set()
            thread.join(DEADLINE)


def run_fleet(*arguments: str, timeout: float = 5 * DEADLINE) -> subprocess.CompletedProcess[str]:
    """Run ``fleet …`` to its end."""
    return subprocess.run(
        [sys.executable, "-m", "fleet_cli", *arguments],
        capture_output=True,
        text=True,
        cwd=ROOT,
        timeout=timeout,
        check=False,
    )


def read_json(path: Path) -> dict[str, Any]:
    """The JSON document of a file."""
    document: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    return document
