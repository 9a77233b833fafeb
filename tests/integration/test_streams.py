"""Services whose output goes nowhere (full disk, closed stream, stuck pipe), and signals while they wait."""

import os
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Any

import pytest
import zenoh

from fleet_bus import Role, keys, open_session
from fleet_bus.errors import SessionError
from fleet_bus.messages import ServiceStatus
from fleet_bus.messages.state import ENCODING
from fleet_bus.pubsub import Received, declare_recovering_subscriber, watch_alive
from fleet_bus.router import Router
from tests.integration.conftest import ROOT, Start
from tests.waiting import wait_until

pytestmark = [pytest.mark.integration, pytest.mark.slow]

#: Seconds that a process has for anything; none of it depends on how fast it is.
LONG = 60.0
SERVICES = {
    "reach": (["reach", "--id", "one"], keys.service("reach", "one")),
    "side-info": (["side-info", "parking-lot", "--id", "one"], keys.service("side-info", "one")),
    "agent": (["agent", "--vehicle", "car"], keys.alive("car")),
}


@contextmanager
def stream(kind: str) -> Iterator[int | None]:
    """A file descriptor that takes no lines; None for a stream that is closed."""
    with ExitStack() as opened:
        if kind == "closed":
            yield None
        elif kind == "full":
            yield opened.enter_context(Path("/dev/full").open("w", encoding="utf-8")).fileno()
        else:
            reading, writing = os.pipe()
            opened.callback(os.close, reading)
            opened.callback(os.close, writing)
            os.set_blocking(writing, False)
            with suppress(BlockingIOError):
                while True:
                    os.write(writing, b"x" * 4096)
            os.set_blocking(writing, True)
            yield writing


@contextmanager
def running(kind: str, *arguments: str) -> Iterator[subprocess.Popen[bytes]]:
    """``fleet -v …`` whose stdout and stderr take no lines."""
    command = [sys.executable, "-m", "fleet_cli", "-v", *arguments]
    with stream(kind) as output:
        if output is None:
            command = ["/bin/sh", "-c", 'exec "$@" >&- 2>&-', "sh", *command]
        with subprocess.Popen(command, stdout=output, stderr=output, cwd=ROOT) as process:
            try:
                yield process
            finally:
                if process.poll() is None:
                    process.kill()


def end(process: subprocess.Popen[bytes]) -> int:
    process.send_signal(signal.SIGTERM)
    return process.wait(LONG)


@contextmanager
def alive(session: zenoh.Session, process: subprocess.Popen[Any], key: str) -> Iterator[None]:
    seen: list[bool] = []

    def there() -> bool:
        assert process.poll() is None, f"it ended with {process.returncode}"
        return True in seen

    with watch_alive(session, key, lambda _, alive: seen.append(alive)):
        wait_until(there, LONG)
        yield


@pytest.mark.parametrize("kind", ["full", "closed", "stuck"])
@pytest.mark.parametrize("name", list(SERVICES))
def test_a_service_works_and_ends_in_order_without_a_log(name: str, kind: str, router: Router) -> None:
    arguments, token = SERVICES[name]
    status: list[ServiceStatus] = []

    def keep(received: Received) -> None:
        status.append(ServiceStatus.decode(received.payload, received.encoding))

    with (
        open_session(Role.SERVICE, router.endpoints) as session,
        running(kind, *arguments, "--router", *router.endpoints) as process,
        alive(session, process, token),
        declare_recovering_subscriber(session, keys.ALL_STATUS, keep, history=1),
    ):
        if name != "agent":
            # Each is logged, or every one that is the first of a second; the second status shows that it went on.
            def refuse() -> None:
                assert process.poll() is None, f"it ended with {process.returncode}"
                session.put(keys.state("car"), b"not msgpack", encoding=ENCODING)

            wait_until(lambda: status and status[-1].refused.get("malformed", 0) > 1, LONG, meanwhile=refuse)
            count = len(status)
            wait_until(lambda: len(status) > count, LONG, meanwhile=refuse)
        assert end(process) == 0


@pytest.mark.parametrize("kind", ["full", "closed", "stuck"])
def test_a_router_works_and_ends_in_order_without_a_log(kind: str) -> None:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    with running(kind, "router", "--port", str(port)) as process:
        opened: list[zenoh.Session] = []

        def connect() -> None:
            assert process.poll() is None, f"it ended with {process.returncode}"
            try:
                opened.append(open_session(Role.VIEWER, [f"tcp/127.0.0.1:{port}"], timeout=0.5))
            except SessionError:
                return

        wait_until(lambda: opened, LONG, meanwhile=connect)
        with opened[0]:
            assert end(process) == 0


@pytest.mark.parametrize("kind", ["full", "closed", "stuck"])
@pytest.mark.parametrize(
    ("code", "arguments"),
    [(1, ["reach", "--router", "tcp/127.0.0.1:1"]), (2, ["agent", "--vehicle", "a b"])],
    ids=["no router", "wrong use"],
)
def test_an_error_that_nobody_reads_ends_with_its_exit_code(code: int, arguments: list[str], kind: str) -> None:
    with running(kind, *arguments) as process:
        assert process.wait(LONG) == code


def test_an_agent_without_a_router_says_so_and_goes_on(start: Start) -> None:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        endpoint = f"tcp/127.0.0.1:{probe.getsockname()[1]}"
    process = start("agent", "--vehicle", "car", "--router", endpoint)
    process.expect(f"not connected yet, still trying: no router answers at {endpoint}", LONG)
    with (
        Router([endpoint]),
        open_session(Role.SERVICE, [endpoint]) as session,
        alive(session, process.process, keys.alive("car")),
    ):
        pass
    assert process.end() == 0


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
@pytest.mark.parametrize("arguments", [["reach"], ["side-info", "parking-lot"]], ids=["reach", "side-info"])
def test_a_service_that_waits_for_a_router_heeds_signals(arguments: list[str], number: signal.Signals) -> None:
    with socket.socket() as mute:
        mute.bind(("127.0.0.1", 0))
        mute.listen()
        mute.settimeout(LONG)
        endpoint = f"tcp/127.0.0.1:{mute.getsockname()[1]}"
        with subprocess.Popen(
            [sys.executable, "-m", "fleet_cli", *arguments, "--router", endpoint],
            stderr=subprocess.PIPE, stdout=subprocess.PIPE, text=True, cwd=ROOT,
        ) as process:  # fmt: skip
            # From here on Zenoh waits for an answer that does not come.
            connection, _ = mute.accept()
            with connection:
                process.send_signal(number)
                _, errors = process.communicate(timeout=LONG)
    assert (process.returncode, errors) == (0, "")
