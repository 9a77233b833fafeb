"""Child processes of the demo: the same command, with its own options, watched and ended together."""

import os
import subprocess
import sys
import threading
import time
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryFile
from typing import IO, Self

from fleet_bus.errors import FleetError
from fleet_cli.commands.shared import ENDS_WITH_STDIN

#: Seconds that a child has to end before it is killed.
END_SECONDS = 5.0


class Child:
    """One ``fleet …`` process; what it writes to stderr is kept for the error message."""

    def __init__(self, name: str, arguments: Sequence[str]) -> None:
        self.name = name
        self._errors: IO[bytes] = TemporaryFile()  # noqa: SIM115 - lives as long as the child
        self.process = subprocess.Popen(
            [sys.executable, "-m", "fleet_cli", *arguments],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._errors,
            # However this process ends: the pipe ends with it, and with the pipe the child.
            env={**os.environ, ENDS_WITH_STDIN: "1"},
            text=True,
            cwd=Path.cwd(),
        )

    def wait_for(self, text: str, timeout: float, stop: threading.Event) -> str:
        """The first line with ``text`` that the process prints, empty if it is told to ``stop`` before.

        Raises ``FleetError`` if it ends before, or takes longer than ``timeout`` seconds.
        """
        found = threading.Event()
        lines: list[str] = []

        def read() -> None:
            assert self.process.stdout is not None
            for line in self.process.stdout:
                if text in line and not found.is_set():
                    lines.append(line.rstrip())
                    found.set()

        threading.Thread(target=read, daemon=True).start()
        deadline = time.monotonic() + timeout
        while not found.wait(0.05):
            if self.process.poll() is not None and not found.wait(0.2):
                raise FleetError(f"{self.name} ended with exit code {self.process.returncode}: {self.errors()}")
            if stop.is_set():
                return ""
            if time.monotonic() > deadline:
                raise FleetError(f"{self.name} did not get ready within {timeout:g} s: {self.errors()}")
        return lines[0]

    def errors(self) -> str:
        """The end of what the process wrote to stderr."""
        self._errors.seek(0)
        return self._errors.read().decode(errors="replace").strip()[-2000:]

    def end(self) -> None:
        """Ask the process to end."""
        if self.process.poll() is None:
            self.process.terminate()

    def join(self) -> int:
        """Exit code of the ended process; kills it if it does not end."""
        try:
            code = self.process.wait(END_SECONDS)
        except subprocess.TimeoutExpired:
            self.process.kill()
            code = self.process.wait()
        for pipe in (self.process.stdin, self.process.stdout):
            if pipe is not None:
                pipe.close()
        return code


class Children:
    """All child processes; leaving the block ends them, the last started first."""

    def __init__(self) -> None:
        self._children: list[Child] = []

    def start(self, name: str, *arguments: str) -> Child:
        """Start ``fleet`` with some arguments."""
        child = Child(name, arguments)
        self._children.append(child)
        return child

    def dead(self) -> Child | None:
        """A child that has ended although it was not asked to."""
        return next((child for child in self._children if child.process.poll() is not None), None)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc_info: object) -> None:
        for child in reversed(self._children):
            child.end()
        for child in reversed(self._children):
            child.join()
