"""A service ends when it is told to, at whatever moment that is."""

import os
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from fleet_cli.commands.shared import stop_on_signals
from tests.waiting import wait_until


@pytest.fixture(autouse=True)
def _handlers() -> Iterator[None]:
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)
    signal.set_wakeup_fd(-1)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_sets_the_event(number: int) -> None:
    stop = stop_on_signals()
    os.kill(os.getpid(), number)
    assert stop.wait(60)


def test_a_signal_at_the_moment_at_which_the_wait_begins_is_heeded() -> None:
    stop = stop_on_signals()
    # Where ``wait`` has looked at the event and has not begun to wait yet, it holds this lock.
    with stop._cond:  # type: ignore[attr-defined]
        os.kill(os.getpid(), signal.SIGTERM)
        assert not stop._flag  # type: ignore[attr-defined]
    assert stop.wait(60)


def test_a_signal_that_another_thread_gets_ends_the_wait_of_the_main_thread() -> None:
    stop = stop_on_signals()

    def get_it() -> None:
        wait_until(lambda: stop._cond._waiters)  # type: ignore[attr-defined]
        signal.pthread_kill(threading.get_ident(), signal.SIGTERM)

    thread = threading.Thread(target=get_it)
    thread.start()
    assert stop.wait(60)
    thread.join()


@pytest.mark.integration
def test_what_a_demo_has_started_ends_with_it_even_if_it_is_killed() -> None:
    demo = subprocess.Popen(
        [sys.executable, "-m", "fleet_cli", "demo", "--headless", "--vehicles", "1", "--duration", "60"],
        stdout=subprocess.PIPE, text=True,
    )  # fmt: skip
    assert demo.stdout is not None
    for line in demo.stdout:
        if "simulated vehicles drive" in line:
            break
    children = set(Path(f"/proc/{demo.pid}/task/{demo.pid}/children").read_text(encoding="ascii").split())
    assert len(children) >= 3
    demo.kill()
    demo.wait()
    demo.stdout.close()
    wait_until(lambda: not any(Path(f"/proc/{child}").exists() for child in children), 30.0)
