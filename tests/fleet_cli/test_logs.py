"""Lines that cannot be written: lost, counted and told, and nobody waits for them."""

import io
import logging
import os
import sys
import threading
import warnings
from collections.abc import Iterator
from pathlib import Path

import pytest
import structlog

from fleet_cli import logs
from fleet_cli.logs import LineWriter
from tests.waiting import wait_until


@pytest.fixture
def pipe() -> Iterator[tuple[int, io.TextIOWrapper]]:
    """Reading end and writing end of a pipe."""
    reading, writing = os.pipe()
    with os.fdopen(writing, "w") as stream:
        yield reading, stream
    os.close(reading)


def fill(stream: io.TextIOWrapper) -> int:
    """Write until the pipe takes no more; how many bytes."""
    descriptor, written = stream.fileno(), 0
    os.set_blocking(descriptor, False)
    try:
        while True:
            written += os.write(descriptor, b"x" * 4096)
    except BlockingIOError:
        os.set_blocking(descriptor, True)
        return written


def drain(reading: int, count: int) -> bytes:
    read = b""
    while len(read) < count:
        read += os.read(reading, count - len(read))
    return read


def test_lines_come_in_order(pipe: tuple[int, io.TextIOWrapper]) -> None:
    reading, stream = pipe
    writer = LineWriter(stream)
    for number in range(100):
        writer.line(f"line {number} ±")
    assert writer.flush(10)
    expected = "".join(f"line {number} ±\n" for number in range(100)).encode()
    assert drain(reading, len(expected)) == expected
    assert writer.lost == 0


def test_a_full_disk_loses_lines_and_counts_them() -> None:
    with Path("/dev/full").open("w", encoding="utf-8") as full:
        writer = LineWriter(full)
        for _ in range(50):
            writer.line("nobody reads this")
        assert writer.flush(10)
    assert writer.lost == 50


def test_a_pipe_without_reader_loses_lines_and_counts_them() -> None:
    reading, writing = os.pipe()
    os.close(reading)
    with os.fdopen(writing, "w") as stream:
        writer = LineWriter(stream)
        writer.line("nobody reads this")
        assert writer.flush(10)
    assert writer.lost == 1


def test_a_stream_that_is_not_there_loses_lines() -> None:
    writer = LineWriter(None)
    writer.line("nobody reads this")
    assert writer.flush(0)
    assert writer.lost == 1


@pytest.mark.parametrize("blocking", [True, False])
def test_nobody_waits_for_a_reader_that_does_not_read(blocking: bool, pipe: tuple[int, io.TextIOWrapper]) -> None:
    reading, stream = pipe
    filled = fill(stream)
    os.set_blocking(stream.fileno(), blocking)
    writer = LineWriter(stream, waiting=10)
    said = threading.Event()

    def say() -> None:
        for number in range(100):
            writer.line(f"line {number}")
        said.set()

    threading.Thread(target=say, daemon=True).start()
    assert said.wait(10)
    assert not writer.flush(0.01)
    # Ten wait, and one may be on its way.
    assert writer.lost in (89, 90)
    kept = 100 - writer.lost
    drain(reading, filled)
    assert writer.flush(10)
    lines = os.read(reading, 4096).decode().splitlines()
    told = [line for line in lines if line.endswith("lines could not be written here")]
    # In one part or in two, as the writer came to it.
    assert sum(int(line.split()[0]) for line in told) == writer.lost
    assert [line for line in lines if line not in told] == [f"line {number}" for number in range(kept)]


def test_a_stream_that_takes_lines_again_tells_how_many_were_lost(monkeypatch: pytest.MonkeyPatch) -> None:
    full = [True]
    written: list[bytes] = []

    def write(descriptor: int, data: memoryview) -> int:
        if full[0]:
            raise OSError(28, "No space left on device")
        written.append(bytes(data))
        return len(data)

    with Path(os.devnull).open("w", encoding="utf-8") as stream:
        writer = LineWriter(stream)
        monkeypatch.setattr(os, "write", write)
        for _ in range(3):
            writer.line("lost")
        assert writer.flush(10)
        full[0] = False
        writer.line("first")
        writer.line("second")
        assert writer.flush(10)
    assert b"".join(written) == b"3 lines could not be written here\nfirst\nsecond\n"


def test_a_stream_without_descriptor_is_written_to_at_once() -> None:
    stream = io.StringIO()
    writer = LineWriter(stream)
    writer.line("here")
    assert stream.getvalue() == "here\n"
    stream.close()
    writer.line("closed")
    assert writer.lost == 1


def test_log_and_warnings_go_to_stderr(monkeypatch: pytest.MonkeyPatch) -> None:
    stream = io.StringIO()
    monkeypatch.setattr(sys, "stderr", stream)
    logs.configure(logging.INFO)
    log = structlog.get_logger("test")
    log.debug("x" * 30)
    log.info("this", number=3)
    try:
        raise ValueError("no such luck")
    except ValueError:
        log.exception("and this")
    with warnings.catch_warnings():
        warnings.simplefilter("always")
        logs.configure(logging.INFO)
        warnings.warn("and that", stacklevel=1)
    text = stream.getvalue()
    assert "x" * 30 not in text
    for words in ("this", "number=3", "and this", "no such luck", "warning: and that"):
        assert words in text


def test_a_log_that_cannot_be_written_raises_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    with Path("/dev/full").open("w", encoding="utf-8") as full:
        monkeypatch.setattr(sys, "stderr", full)
        monkeypatch.setattr(sys, "stdout", full)
        logs.configure(logging.INFO)
        structlog.get_logger("test").warning("lost")
        logs.say("lost")
        logs.warn("lost")
        logs.flush()
        wait_until(lambda: logs._writers["stderr"].lost == 2 and logs._writers["stdout"].lost == 1)
