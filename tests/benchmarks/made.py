"""Reports and benchmarks made up for tests."""

import signal
import sys
from collections.abc import Callable, Sequence
from types import ModuleType

import pytest

from benchmarks import suite
from benchmarks.plots import bars
from benchmarks.report import Cell, Claim, Conditions, Outcome, Report, Table

CONDITIONS = Conditions(
    date="2026-11-22T12:00:00+00:00", machine="m", cores=2, threads=1, load=0.1, python="3.11", commit=None,
    versions={"numpy": "2.4"},
)  # fmt: skip
ROWS: tuple[tuple[Cell, ...], ...] = (("ours", 1.25), ("theirs", 12345.6))
CLAIMS = (
    Claim("enough", 21.0, "≥", 20.0),
    Claim("too much", 1.6, "≤", 1.5),
    Claim("unknown", float("nan"), "≤", 1.0),
)


def table(rows: Sequence[tuple[Cell, ...]] = ROWS, claims: Sequence[Claim] = CLAIMS) -> Table:
    """One benchmark's."""
    return Table("A", "Note.", ("way", "µs"), list(rows), list(claims))


def report(tables: dict[str, Table] | None = None, **changes: object) -> Report:
    """A run in which all were done."""
    done = {name: Outcome(status="done", seconds=1.0, table=one) for name, one in (tables or {"a": table()}).items()}
    fields = {"complete": True, "quick": False, "conditions": CONDITIONS, "benchmarks": done}
    return Report.model_validate(fields | changes)


def works(quick: bool) -> Table:
    """A benchmark that works."""
    return table()


def raises(quick: bool) -> Table:
    """One that does not."""
    raise ArithmeticError("no way")


def lacks(quick: bool) -> Table:
    """One whose peer is not there."""
    raise ModuleNotFoundError("No module named 'zonoopt'", name="zonoopt")


def ended_by(number: signal.Signals) -> Callable[[bool], Table]:
    """One in the middle of which a signal comes."""

    def run(quick: bool) -> Table:
        signal.raise_signal(number)
        raise AssertionError("went on")

    return run


def install(monkeypatch: pytest.MonkeyPatch, **benchmarks: Callable[[bool], Table]) -> None:
    """Let these be the benchmarks of the suite."""
    for name, run in benchmarks.items():
        module = ModuleType(f"benchmarks.{name}")
        module.run = run  # type: ignore[attr-defined]
        module.plot = lambda table: bars(table, lambda row: "all", lambda row: str(row[0]), 1, "µs")  # type: ignore[attr-defined]
        monkeypatch.setitem(sys.modules, f"benchmarks.{name}", module)
    monkeypatch.setattr(suite, "BENCHMARKS", dict.fromkeys(benchmarks, "made up"))
