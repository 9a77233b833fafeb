"""A report as Markdown: what was asked first, then the tables with their plots."""

from collections.abc import Iterable, Sequence
from datetime import datetime

from benchmarks.conditions import busy
from benchmarks.history import Comparison
from benchmarks.report import Cell, Claim, Outcome, Report, Table


def as_markdown(report: Report, comparison: Comparison | None = None) -> str:
    """The whole report; plots are linked as they lie in its folder."""
    lines = [f"# Benchmarks, {when(report)}", "", *conditions_lines(report), ""]
    if report.quick:
        lines += ["**A quick run: few sets and repeats. It shows that all of it runs; its figures say nothing.**", ""]
    if not report.complete:
        lines += ["**Not complete:** see below what failed or was not run.", ""]
    lines += claims_lines(report.claims)
    if comparison is not None:
        lines += ["", *comparison_lines(comparison)]
    for name, outcome in report.benchmarks.items():
        lines += ["", *outcome_lines(name, outcome)]
    return "\n".join(lines) + "\n"


def conditions_lines(report: Report) -> list[str]:
    """Machine, versions, date, and whether the machine was busy."""
    where = report.conditions
    packages = ", ".join(f"{name} {number}" for name, number in where.versions.items())
    commit = "" if where.commit is None else f", commit {where.commit}"
    threads = "one thread" if where.threads == 1 else f"{where.threads} threads"
    load = "unknown" if where.load is None else f"{where.load:.2f}"
    lines = [
        f"{when(report)}{commit}. {where.machine}, {where.cores} cores, {threads} a side, load {load} at the start; "
        f"Python {where.python}, {packages}.",
        "Times are medians unless a column says otherwise.",
    ]
    warning = busy(where)
    return lines if warning is None else [*lines, "", f"**Warning:** {warning}."]


def when(report: Report) -> str:
    """Date and time of a run."""
    return f"{datetime.fromisoformat(report.conditions.date):%Y-%m-%d %H:%M} UTC"


def claims_lines(claims: Sequence[Claim]) -> list[str]:
    """Every claim with what was measured."""
    if not claims:
        return ["Nothing was claimed."]
    met = sum(claim.met for claim in claims)
    return [f"{met} of {len(claims)} claims are met.", "", *claims_table(claims)]


def claims_table(claims: Sequence[Claim]) -> list[str]:
    """What was asked, measured and wanted."""
    rows = [(c.text, text(c.value), f"{c.relation} {text(c.bound)}", "met" if c.met else "**MISSED**") for c in claims]
    return table_lines(("asked", "measured", "wanted", ""), rows, "-::-")


def outcome_lines(name: str, outcome: Outcome) -> list[str]:
    """A benchmark: its table and plot, or why there is none."""
    if outcome.table is None:
        said = outcome.status if not outcome.message else f"{outcome.status}: {outcome.message}"
        return [f"## {name}", "", f"**{said}**"]
    table = outcome.table
    took = "" if outcome.seconds is None else f" ({outcome.seconds:.0f} s)"
    lines = [f"## {table.title}", "", f"`{name}`{took}. {table.note}", ""]
    if outcome.message:
        lines += [f"**{outcome.status}: {outcome.message}**", ""]
    if outcome.plot is not None:
        lines += [f"![{table.title}]({outcome.plot})", ""]
    return lines + figures_lines(table)


def figures_lines(table: Table) -> list[str]:
    """The rows of a table; columns of numbers are aligned to the right."""
    numeric = [all(not isinstance(row[i], str) for row in table.rows) for i in range(len(table.columns))]
    align = "".join(":" if number else "-" for number in numeric)
    return table_lines(table.columns, [tuple(map(text, row)) for row in table.rows], align)


def comparison_lines(comparison: Comparison) -> list[str]:
    """What has changed since an earlier run."""
    lines = [f"## Since {comparison.then}", ""]
    lines += [f"* {difference}" for difference in comparison.differences]
    lines += [""] if comparison.differences else []
    lines.append(f"{comparison.summary}{':' if comparison.changes else '.'}")
    if comparison.changes:
        rows = [(c.benchmark, c.row, c.figure, *change_cells(c.then, c.now, c.ratio)) for c in comparison.changes]
        lines += ["", *table_lines(("benchmark", "row", "figure", "then", "now", "ratio"), rows, "---:::")]
    lines += [
        f"\nClaim *{claim.text}*: {'met now, missed then' if claim.met else 'MISSED now, met then'}."
        for claim in comparison.turned
    ]
    return lines


def change_cells(then: float, now: float, ratio: float | None) -> tuple[str, str, str]:
    """A change as text."""
    return text(then), text(now), text(ratio)


def table_lines(columns: Iterable[str], rows: Iterable[Sequence[str]], align: str) -> list[str]:
    """A table of Markdown; ``align`` has ``:`` for each column that goes to the right, ``-`` for others."""
    head = [_row(columns), _row("---:" if one == ":" else "---" for one in align)]
    return head + [_row(cell.replace("|", "&#124;") for cell in row) for row in rows]


def text(cell: Cell) -> str:
    """Three significant digits of a measured number."""
    if cell is None:
        return "–"
    if not isinstance(cell, float):
        return str(cell)
    return f"{cell:.3g}" if abs(cell) < 1000 else f"{cell:.0f}"


def _row(cells: Iterable[str]) -> str:
    return f"| {' | '.join(cells)} |"
