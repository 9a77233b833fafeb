"""The page of measured figures in the documentation, made of a report and of nothing else.

``python -m benchmarks.docs_page`` makes page and plots anew from the figures they were made of.
"""

import os
import shutil
from collections.abc import Iterator
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Final

from benchmarks.conditions import ROOT, changed, load
from benchmarks.page import claims_table, conditions_lines, figures_lines, text
from benchmarks.report import Outcome, Report, read
from benchmarks.suite import draw
from fleet_bus.errors import UsageError
from fleet_lab.files import write_text

DOCS: Final = ROOT / "docs"
PAGE, FIGURES = "benchmarks.md", "benchmarks.json"
#: Busy cores of all, before the start, from which on nothing is published.
TOO_BUSY: Final = 0.7
#: Rows beyond which a table is folded away.
LONG: Final = 24

INTRODUCTION: Final = """\
What is said about speed and tightness here and elsewhere on these pages was measured by one command, in one run, and
can be measured again:

```console
$ fleet bench
```

(`make bench` in a checkout; see [the command](reference/command.md#fleet-bench).) It writes a report like this page,
keeps it, and says what has changed since the run before. This page is written by that command, too, with `--docs`, from
[its figures](benchmarks.json); a test holds the two together, so no number here was typed by anybody.

**How to read it.** Times are those of one machine: believe the ratios. A time is a median; *25 %* and *75 %* are the
quartiles, *longest* says what stands in the note of its table. Every side of a comparison gets the same sets, samples
or messages in the same process and on one thread, one after the other; Python's garbage collection stays on, but looks
at no objects that others have left. Peers run at their documented defaults, and at a tight tolerance too where that
matters. What a table calls a *claim* is what this project wants of itself: where it is missed, it says so.

**What is compared with what.** The update of the engine with the published algorithm, written down line by line
[AJS+22]; operations on sets with ZonoOpt, with linear programs by HiGHS, and with polygons clipped by Shapely; formulas
followed online with the monitor of RTAMT; cuts by strips and by a disc with the algorithms of the paper; guaranteed
sets with the states of simulated systems whose truth is known, calibrated ones with recordings of real cars.

**What is not measured here.** No network: what a tube takes from sample to subscriber is in the summary of `fleet demo`
and in the [status of a server](concepts/guarantees.md#what-is-measured-at-run-time). No car of yours:
[your own recording](how-to/own-recording.md) says how to measure that. No other machine than the one named, no second
thread, no peer with a compiled back end that its package does not bring (RTAMT has one to be built by hand). Peers
solve more general problems than the ones put here; nothing is said about those."""


@dataclass(frozen=True, slots=True)
class Section:
    """Benchmarks that belong together."""

    title: str
    text: str
    names: tuple[str, ...]


SECTIONS: Final = (
    Section(
        "An update of the engine",
        "How long it takes from the samples of a fleet to its tubes, and what that grows with.",
        ("updates", "curves", "vehicles", "wire"),
    ),
    Section(
        "Soundness and tightness",
        "Whether sets hold what they promise, how large they are, and how well the audit tells. "
        "[What is guaranteed](concepts/guarantees.md) says under which assumptions.",
        ("containment", "recordings", "audit"),
    ),
    Section(
        "Operations on sets",
        "The [set library](concepts/sets.md) beside its peers. A bound that is too small is worse than a slow one, so "
        "values are held against linear programs as well.",
        ("support", "outline", "constraints", "strips", "disc", "growth"),
    ),
    Section(
        "Side information",
        "What following formulas costs, and what it costs to get them wrong; see "
        "[side information](concepts/side-information.md).",
        ("monitoring", "progression", "encodings"),
    ),
)


def page(report: Report) -> str:
    """The page, from a complete report."""
    lines = ["# Benchmarks", "", INTRODUCTION, "", "## In short", "", *_summary(report), ""]
    lines += ["Measured " + line if i == 0 else line for i, line in enumerate(conditions_lines(report))]
    for section in SECTIONS:
        lines += ["", f"## {section.title}", "", section.text]
        for name in section.names:
            lines += ["", *_outcome(name, report.benchmarks[name])]
    return "\n".join(lines) + "\n"


def check(*, whole: bool, even_so: bool = False) -> None:
    """Raise ``UsageError`` unless the page can be written: only from a full run, and in a checkout; and unless
    ``even_so``, only of code that is committed, on a machine with little else to do."""
    if not whole:
        raise UsageError("--docs: only a full run of all benchmarks makes the page: leave names and --quick away")
    if not (DOCS / "index.md").is_file():
        raise UsageError(f"--docs: {DOCS} is not the documentation of a checkout")
    if even_so:
        return
    if files := changed(outside="docs"):
        named = ", ".join(files[:5]) + (", …" if len(files) > 5 else "")
        raise UsageError(f"--docs: the figures would be of no commit: commit {named} first, or add --even-so")
    cores = os.cpu_count() or 1
    if (busy := load()) > TOO_BUSY * cores:
        raise UsageError(
            f"--docs: {busy:.1f} of {cores} cores were busy in the last minute: end other work and wait until less "
            f"than {TOO_BUSY * cores:.1f} are, or add --even-so"
        )


def write(report: Report, folder: Path) -> Path:
    """Write page, figures and the plots of a report that lies in ``folder``; path of the page."""
    for name, outcome in report.benchmarks.items():
        if outcome.plot is not None:
            shutil.copyfile(folder / outcome.plot, DOCS / _picture(name))
    write_text("--docs", DOCS / FIGURES, report.as_text())
    write_text("--docs", DOCS / PAGE, page(report))
    return DOCS / PAGE


def _picture(name: str) -> str:
    return f"pictures/bench-{name}.png"


def _summary(report: Report) -> list[str]:
    missed = [claim for claim in report.claims if not claim.met]
    met = len(report.claims) - len(missed)
    if not missed:
        return [f"All {met} claims are met."]
    return [
        f"{met} of {len(report.claims)} claims are met. **Missed:**",
        "",
        *(f"* {c.text}: {text(c.value)}, wanted {c.relation} {text(c.bound)}." for c in missed),
    ]


def _outcome(name: str, outcome: Outcome) -> Iterator[str]:
    if outcome.table is None:
        raise UsageError(f"{name} was not finished: the page is made of complete reports only")
    table = outcome.table
    yield from (f"### {table.title}", "", f"`fleet bench {name}`: {table.note}")
    if outcome.plot is not None:
        yield from ("", f"![{table.title}]({_picture(name)})")
    if table.claims:
        yield from ("", *claims_table(table.claims))
    folded = len(table.rows) > LONG
    if folded:
        yield from ("", '<details markdown="1">', f"<summary>All {len(table.rows)} rows</summary>")
    yield from ("", *figures_lines(table))
    if folded:
        yield from ("", "</details>")


def renew() -> None:
    """Write page and plots once more from the figures, after a change of words or drawing."""
    report = read(DOCS / FIGURES, FIGURES)
    for name, outcome in report.benchmarks.items():
        if outcome.plot is not None:
            draw(import_module(f"benchmarks.{name}"), report.tables[name], DOCS / _picture(name))
    write_text("--docs", DOCS / PAGE, page(report))


if __name__ == "__main__":
    renew()
