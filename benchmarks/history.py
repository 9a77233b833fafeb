"""Earlier runs, and what has changed since."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from typing import Final

from benchmarks.report import Claim, Report, read
from fleet_bus.errors import UsageError
from fleet_lab.files import write_text

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
    """Write a report to the history, under its date and time, numbered if there is one of that second; the file."""
    stamp = report.conditions.date.partition("+")[0].replace(":", "-")
    path = _taken(folder, f"{stamp}Z")
    try:
        write_text("-o", path, report.as_text())
    except BaseException:
        path.unlink(missing_ok=True)
        raise
    return path


def _taken(folder: Path, name: str) -> Path:
    """A new and empty file, which no other run has; those of the same name are sorted as they came."""
    for number in count(1):
        path = folder / (f"{name}.json" if number == 1 else f"{name}_{number:02}.json")
        try:
            path.touch(exist_ok=False)
        except FileExistsError:
            continue
        except OSError as error:
            raise UsageError(f"-o {path}: cannot be written: {error}") from None
        return path
    raise AssertionError


def earlier(which: str | None, folder: Path, warn: Callable[[str], None], *, quick: bool) -> tuple[str, Report] | None:
    """The run to compare with, and its name: a file, the newest one of the history, or without a wish the newest one
    of the same kind, if there is one. Files of the history that are no reports are left out, and ``warn`` is told;
    raise ``UsageError`` if the file asked for is none, or there is no newest one."""
    if which is not None and which != LATEST:
        return Path(which).name, read(Path(which), "--compare")
    for path in sorted(folder.glob("*.json"), reverse=True):
        try:
            report = read(path, "history")
        except UsageError as error:
            warn(f"left out of the comparison: {error}")
            continue
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
