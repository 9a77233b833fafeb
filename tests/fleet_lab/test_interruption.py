"""Signals during long work, with real ones, in compiled code and out of it."""

import os
import signal
import subprocess
import sys
import threading

import pytest

from fleet_lab.interruption import Interruption


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_is_raised_once_and_handlers_are_put_back(number: signal.Signals) -> None:
    before = signal.getsignal(number)
    with Interruption() as interruption:
        asked = [interruption.asked]
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(number)
        asked.append(interruption.asked)
        signal.raise_signal(number)
        with interruption.held():
            signal.raise_signal(number)
    assert asked == [False, True]
    assert signal.getsignal(number) is before


def test_a_signal_waits_while_it_is_held() -> None:
    done = []

    def write(interruption: Interruption) -> None:
        with interruption.held():
            with interruption.held():
                signal.raise_signal(signal.SIGTERM)
                done.append("inner")
            done.append("outer")
        done.append("after")

    with Interruption() as interruption:
        with pytest.raises(KeyboardInterrupt):
            write(interruption)
        done.append("asked" if interruption.asked else "not asked")
    assert done == ["inner", "outer", "asked"]


def test_what_was_made_of_it_is_known() -> None:
    def wrapped() -> None:
        try:
            raise KeyboardInterrupt
        except KeyboardInterrupt as error:
            raise SystemError("a result with an exception set") from error

    with Interruption() as interruption:
        assert not interruption.is_cause_of(ValueError("of its own"))
        with pytest.raises(SystemError) as caught:
            wrapped()
        assert interruption.is_cause_of(caught.value)
        # From now on it is being handled.
        signal.raise_signal(signal.SIGINT)
    with Interruption() as interruption:
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)
        assert interruption.is_cause_of(ValueError("without a trace of it"))


def test_other_threads_do_without() -> None:
    before, found = signal.getsignal(signal.SIGINT), []

    def work() -> None:
        with Interruption() as interruption, interruption.held():
            found.append((interruption.asked, signal.getsignal(signal.SIGINT)))

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert found == [(False, before)]


#: Compiled work without end unless it is ended; the report of a signal is what the command would do with it.
COMPILED = """
import sys
import numba
from pathlib import Path
from types import ModuleType
from benchmarks import suite

@numba.njit
def turn(count):
    total = 0.0
    for i in range(count):
        total += (i % 7) ** 0.5
    return total

def run(quick):
    turn(10)
    print("ready", flush=True)
    while True:
        turn(10_000_000)

sys.modules["benchmarks.compiled"] = module = ModuleType("benchmarks.compiled")
module.run = run
tell = lambda number, name, outcome: None
report = suite.run(["compiled", "wire"], lambda report: None, Path("."), tell, quick=True)
print(report.complete, *(f"{one.status}: {one.message}" for one in report.benchmarks.values()), sep="|")
"""


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_in_compiled_code_ends_the_run(number: signal.Signals) -> None:
    pytest.importorskip("numba")
    process = subprocess.Popen(
        [sys.executable, "-c", COMPILED], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},
    )  # fmt: skip
    try:
        assert process.stdout is not None
        assert process.stdout.readline() == "ready\n"
        process.send_signal(number)
        process.send_signal(number)
        said, errors = process.communicate(timeout=60)
    finally:
        process.kill()
    assert said == "False|not run: interrupted|not run: interrupted\n", errors
    assert "Traceback" not in errors
