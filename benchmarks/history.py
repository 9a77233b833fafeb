"""Earlier runs, and what has changed since."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from benchmarks.files import write
from benchmarks.report import Claim, Report, read
from fleet_bus.errors import UsageError

LATEST: Final = "latest"


@dataclass(frozen=True, slots=True)
class Change:
    """A figure then and now; ``ratio`` of now to then, None where then is zero."""

    benchmark: str
    row: str
    figure: str
    then: float
    now: float

    @property
    def ratio(self) -> float | None:
        """Now over then."""
        return self.now / self.then if self.then else None


@dataclass(frozen=True, slots=True)
class Comparison:
    """A run held against an earlier one: figures that changed by more than ``percent``, out of ``compared``."""

    then: str
    percent: float
    compared: int
    changes: list[Change]
    #: Claims that were met then and are not now, and the other way round.
    turned: list[Claim]
    #: What was different besides: machine, versions, kind of run.
    differences: list[str]

    @property
    def summary(self) -> str:
        """How many figures changed."""
        return f"{len(self.changes)} of {self.compared} figures changed by more than {self.percent:g} %"


def keep(report: Report, folder: Path) -> Path:
    """Write a report to the history, under its date and time; the file."""
    stamp = report.conditions.date.partition("+")[0].replace(":", "-")
    path = folder / f"{stamp}Z.json"
    write(path, report.as_text())
    return path


def earlier(which: str | None, folder: Path, *, quick: bool) -> tuple[str, Report] | None:
    """The run to compare with, and its name: a file, the newest one of the history, or without a wish the newest one
    of the same kind, if there is one. Raise ``UsageError`` if there is none, or it is not a report."""
    if which is not None and which != LATEST:
        return Path(which).name, read(Path(which), "--compare")
    for path in sorted(folder.glob("*.json"), reverse=True):
        report = read(path, "--compare")
        if which == LATEST or report.quick == quick:
            return path.name, report
    if which == LATEST:
        raise UsageError(f"--compare {LATEST}: there is no earlier run in {folder}")
    return None


def compare(name: str, then: Report, now: Report, percent: float) -> Comparison:
    """What both have, figure by figure: those of the same benchmark, row and column."""
    compared = 0
    changes = []
    for benchmark, row, figure, before, after in _both(then, now):
        compared += 1
        low, high = sorted((before, after))
        # Of either sign: a half and a double are the same change.
        if low != high and (low <= 0 or high > low * (1 + percent / 100)):
            changes.append(Change(benchmark, row, figure, before, after))
    met = {claim.text: claim.met for claim in then.claims}
    turned = [claim for claim in now.claims if met.get(claim.text, claim.met) != claim.met]
    dated = f"{name} ({then.conditions.date})"
    return Comparison(dated, percent, compared, changes, turned, list(_differences(then, now)))


def _both(then: Report, now: Report) -> Iterator[tuple[str, str, str, float, float]]:
    for benchmark, table in now.tables.items():
        if benchmark in then.tables:
            before = {(row, figure): value for row, figure, value in then.tables[benchmark].figures()}
            for row, figure, value in table.figures():
                if (row, figure) in before:
                    yield benchmark, row, figure, before[row, figure], value


def _differences(then: Report, now: Report) -> Iterator[str]:
    if then.quick != now.quick:
        yield f"then a {_kind(then)} run, now a {_kind(now)} one"
    before, after = then.conditions, now.conditions
    for what in ("machine", "cores", "threads", "python"):
        a, b = getattr(before, what), getattr(after, what)
        if a != b:
            yield f"{what}: then {a}, now {b}"
    for package in sorted({*before.versions, *after.versions}):
        a, b = before.versions.get(package, "–"), after.versions.get(package, "–")
        if a != b:
            yield f"{package}: then {a}, now {b}"


def _kind(report: Report) -> str:
    return "quick" if report.quick else "full"
