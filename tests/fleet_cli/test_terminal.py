"""Output that may be a pipe, and tables that fit."""

import io
import json
import os
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from fleet_bus.errors import FleetError
from fleet_cli.terminal import Column, Keys, Output, ReaderGoneError, as_text, fitted, number, printable, seconds
from tests.docs.test_docs import ROOT

COLUMNS = (Column("name"), Column("first", 1), Column("second", 2, right=True), Column("remark", rest=True))
ROWS = [("car1", "111", "2222", "a long remark that does not fit in here"), ("car10", "1", "2", "")]


def table(width: int) -> list[str]:
    return as_text(fitted(COLUMNS, ROWS, ["red", ""], width), width=width).splitlines()


def test_columns_are_left_out_by_what_they_matter() -> None:
    assert table(120) == [
        "name  first second remark",
        "car1  111     2222 a long remark that does not fit in here",
        "car10 1          2",
    ]
    assert table(48)[1] == "car1  111   a long remark that does not fit in …"
    assert table(48)[0].split() == ["name", "first", "remark"]
    assert table(40)[0].split() == ["name", "remark"]
    for width in (10, 20, 40, 80):
        assert max(map(len, table(width))) <= width
    assert as_text(fitted(COLUMNS, [], [], 80), width=80).split() == ["name", "first", "second", "remark"]


def test_nothing_that_a_terminal_obeys_is_printed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.delenv("NO_COLOR", raising=False)
    assert printable("a\x1b[2Jb\nc\x9b\u202ed") == "a\N{REPLACEMENT CHARACTER}[2Jb" + "".join(
        "\N{REPLACEMENT CHARACTER}" + c for c in ("c", "", "d")
    )
    assert printable("Größe 3 µs ≤ ∞") == "Größe 3 µs ≤ ∞"
    assert "\x1b" not in as_text(fitted(COLUMNS, ROWS, ["red", "dim"], 80), width=80)
    assert "\x1b[31m" in as_text(fitted(COLUMNS, ROWS, ["red", "dim"], 80), width=80, terminal=True)


def test_numbers_for_people() -> None:
    assert [seconds(v) for v in (None, 0.054, 12.4, 300.0, 9000.0)] == ["–", "0.05 s", "12 s", "5 min", "2 h"]
    assert [number(v, "B") for v in (None, float("nan"), 12.0, 6912.0, 3.4e6)] == [
        "–",
        "–",
        "12 B",
        "6.91 kB",
        "3.4 MB",
    ]
    assert number(7.0) == "7"


def test_json_lines_never_hold_what_json_has_not(monkeypatch: pytest.MonkeyPatch) -> None:
    written = io.StringIO()
    monkeypatch.setattr(sys, "stdout", written)
    Output().json({"a": float("nan"), "b": [1.0, float("inf")], "c": {"d": (-float("inf"), "x\ny")}})
    (line,) = written.getvalue().splitlines()
    found = json.loads(line, parse_constant=pytest.fail)
    assert found == {"a": None, "b": [1.0, None], "c": {"d": [None, "x\ny"]}}


WRITE = """
import sys
from fleet_cli.terminal import Output, ReaderGoneError
output = Output()
try:
    {}
except ReaderGoneError:
    sys.exit(7)
"""


def ends(body: str, stdout: int) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-c", WRITE.format(body)], stdout=stdout, stderr=subprocess.PIPE, text=True, cwd=ROOT,
        timeout=60, check=False,
    )  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("body", ["output.json({'a': 1})", "output.check()"])
def test_who_writes_to_a_closed_pipe_is_told_and_says_nothing(body: str) -> None:
    reader, writer = os.pipe()
    os.close(reader)
    try:
        done = ends(body, writer)
    finally:
        os.close(writer)
    assert done.returncode == 7
    assert done.stderr == ""


@pytest.mark.slow
def test_a_full_disk_is_an_error_in_words() -> None:
    if not Path("/dev/full").exists():
        pytest.skip("there is no device that is always full")
    with open("/dev/full", "w", encoding="utf-8") as full:  # noqa: PTH123 - a device
        done = ends("output.text('x')", full.fileno())
    assert done.stderr.splitlines()[-1].startswith(f"{FleetError.__module__}.FleetError: stdout takes no more: ")
    assert "Exception ignored" not in done.stderr


def test_a_pipe_that_is_read_from_is_no_reason_to_end(monkeypatch: pytest.MonkeyPatch) -> None:
    reader, writer = os.pipe()
    with os.fdopen(writer, "w") as stdout:
        monkeypatch.setattr(sys, "stdout", stdout)
        output = Output()
        output.check()
        output.text("a line\n")
        assert os.read(reader, 100) == b"a line\n"
        os.close(reader)
        # What is thrown away lets the stream be closed in silence.
        with pytest.raises(ReaderGoneError):
            output.text("another\n")


@pytest.mark.parametrize(("pressed", "left"), [(b"q", True), (b"Q", True), (b"x", False), (b"", False)])
def test_the_key_q_leaves(pressed: bytes, left: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    master, slave = os.openpty()
    monkeypatch.setattr(os, "tcgetpgrp", lambda descriptor: os.getpgrp())
    with os.fdopen(slave, "r") as stdin:
        monkeypatch.setattr(sys, "stdin", stdin)
        with Keys(threading.Event()) as keys:
            os.write(master, pressed)
            assert keys.left(60.0 if left else 0.1) is left
    os.close(master)


def test_a_signal_leaves_at_once() -> None:
    stop = threading.Event()
    stop.set()
    with Keys(stop) as keys:
        assert keys.left(60.0)
