"""``fleet bench``: speed and tightness, beside peers."""

import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich import box
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from fleet_bus.errors import UsageError
from fleet_lab.files import check_writable, make_folder, write_json, write_text

if TYPE_CHECKING:
    from benchmarks.history import Comparison
    from benchmarks.report import Outcome, Report


def bench(
    names: Annotated[list[str] | None, typer.Argument(help="Benchmarks to run, else all; see --list.")] = None,
    output: Annotated[
        Path, typer.Option("-o", "--output", help="Folder for report.md, report.json, plots/ and history/.")
    ] = Path("bench"),
    json_file: Annotated[Path | None, typer.Option("--json", help="Write the report here; '-' for stdout.")] = None,
    quick: Annotated[bool, typer.Option("--quick", help="Few sets and repeats: does it run?")] = False,
    compare: Annotated[
        str | None, typer.Option(help="Report to compare with, or 'latest'; else the newest of the same kind, if any.")
    ] = None,
    threshold: Annotated[float, typer.Option(help="Show figures that changed by more than this, %.", min=0.0)] = 10.0,
    docs: Annotated[bool, typer.Option("--docs", help="Write what was measured into docs/ of this checkout.")] = False,
    even_so: Annotated[
        bool, typer.Option("--even-so", help="With --docs: on a busy machine and with uncommitted changes, too.")
    ] = False,
    list_: Annotated[bool, typer.Option("--list", help="Name the benchmarks and what they ask.")] = False,
) -> None:
    """Speed and tightness beside peers, in one report that is kept and compared with the one before."""
    from benchmarks import suite
    from benchmarks.conditions import THREADS

    if list_:
        for name, asks in suite.BENCHMARKS.items():
            print(f"{name:<12} {asks}")
        return
    unknown = [name for name in names or () if name not in suite.BENCHMARKS]
    if unknown:
        raise UsageError(f"no benchmark {', '.join(unknown)}: there are {', '.join(suite.BENCHMARKS)}")
    if any(name not in os.environ for name in THREADS):
        # NumPy is loaded by now, with a thread for each core: begin again, having said how many each side may use.
        os.execve(sys.executable, [sys.executable, *sys.orig_argv[1:]], {**THREADS, **os.environ})

    from benchmarks import docs_page, history
    from benchmarks.page import as_markdown

    for folder in (output, output / "plots", output / "history"):
        make_folder("-o", folder)
    check_writable("--json", json_file)
    if docs:
        docs_page.check(whole=not names and not quick, even_so=even_so)
    earlier = history.earlier(compare, output / "history", _warn, quick=quick)

    def comparison(report: "Report") -> "Comparison | None":
        return None if earlier is None else history.compare(*earlier, report, threshold)

    def keep(report: "Report") -> None:
        write_text("-o", output / "report.json", report.as_text())
        write_text("-o", output / "report.md", as_markdown(report, comparison(report)))

    chosen = list(dict.fromkeys(names or suite.BENCHMARKS))
    report = suite.run(chosen, keep, output / "plots", _teller(len(chosen)), quick=quick)
    if report.tables:
        history.keep(report, output / "history")
    if str(json_file) != "-":
        _print(report, comparison(report), output / "report.md")
    write_json(report.model_dump(mode="json"), json_file)
    if docs:
        written = docs_page.write(report, output) if report.complete else "not written, since the run is not complete"
        print(f"docs: {written}", file=sys.stderr)
    if not report.complete:
        sys.exit(130 if suite.interrupted(report) else 1)


def _warn(what: str) -> None:
    Console(stderr=True, highlight=False).print(f"[bold yellow]warning[/]: {escape(what)}", soft_wrap=True)


def _teller(count: int) -> Callable[[int, str, "Outcome | None"], None]:
    """Says on stderr which benchmark of how many runs; nothing moves meanwhile, which would take time from it."""
    console = Console(stderr=True, highlight=False)

    def tell(number: int, name: str, outcome: "Outcome | None") -> None:
        place = escape(f"[{number}/{count}]")
        if outcome is None:
            console.print(f"{place} {name} …")
            return
        took = "" if outcome.seconds is None else f" {outcome.seconds:.1f} s"
        said = "" if not outcome.message else f": {escape(outcome.message)}"
        colour = "green" if outcome.status == "done" else "bold red"
        console.print(f"{place} {name} [{colour}]{outcome.status}[/]{took}{said}", soft_wrap=True)

    return tell


def _print(report: "Report", comparison: "Comparison | None", path: Path) -> None:
    """What was missed, what changed, and where the report is."""
    from benchmarks import page
    from benchmarks.conditions import busy

    console = Console(highlight=False)
    warning = busy(report.conditions)
    if warning is not None:
        console.print(f"[bold yellow]warning[/]: {escape(warning)}", soft_wrap=True)
    if comparison is not None:
        _print_comparison(console, comparison)
    for claim in report.claims:
        if not claim.met:
            wanted = f"{claim.relation} {page.text(claim.bound)}"
            console.print(
                f"[bold red]missed[/]: {escape(claim.text)}: {page.text(claim.value)}, wanted {wanted}", soft_wrap=True
            )
    met = sum(claim.met for claim in report.claims)
    if report.claims:
        console.print(f"{met} of {len(report.claims)} claims are met", soft_wrap=True)
    for name, outcome in report.benchmarks.items():
        if outcome.status != "done":
            console.print(f"[bold red]{outcome.status}[/]: {name}: {escape(outcome.message)}", soft_wrap=True)
    console.print(f"report: {path}", soft_wrap=True)


def _print_comparison(console: Console, comparison: "Comparison") -> None:
    from benchmarks import page

    console.print(f"since {comparison.then}: {comparison.summary}", soft_wrap=True)
    for difference in comparison.differences:
        console.print(f"  {escape(difference)}", soft_wrap=True)
    if comparison.changes:
        table = Table(box=box.SIMPLE_HEAD, padding=(0, 0, 0, 1), pad_edge=False)
        for column in ("benchmark", "row", "figure"):
            table.add_column(column, overflow="fold")
        for column in ("then", "now", "ratio"):
            table.add_column(column, justify="right", no_wrap=True)
        for c in comparison.changes:
            cells = page.change_cells(c.then, c.now, c.ratio)
            table.add_row(c.benchmark, escape(c.row), escape(c.figure), *cells)
        console.print(table)
    for claim in comparison.turned:
        turned = "met now, missed then" if claim.met else "[bold red]missed now[/], met then"
        console.print(f"{escape(claim.text)}: {turned}", soft_wrap=True)
