"""What a benchmark hands back, and how it is written down: Markdown for people, JSON for programs."""

import os
import platform
from collections.abc import Iterable
from dataclasses import dataclass, field
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, Literal

Cell = str | int | float

#: Packages whose versions say what was measured.
PACKAGES = ("numpy", "scipy", "numba", "highspy", "zonoopt", "shapely", "eclipse-zenoh")


@dataclass(frozen=True)
class Claim:
    """A figure of merit and what it must be."""

    text: str
    value: float
    relation: Literal["≥", "≤"]
    bound: float

    @property
    def met(self) -> bool:
        """Does the figure keep the bound? NaN does not."""
        return self.value >= self.bound if self.relation == "≥" else self.value <= self.bound


@dataclass(frozen=True)
class Table:
    """Rows under ``columns``, and a sentence on how they were obtained."""

    title: str
    note: str
    columns: tuple[str, ...]
    rows: list[tuple[Cell, ...]]
    claims: list[Claim] = field(default_factory=list)


def conditions() -> dict[str, Any]:
    """Date, machine and versions."""
    versions = {}
    for name in PACKAGES:
        try:
            versions[name] = version(name)
        except PackageNotFoundError:
            versions[name] = "not installed"
    return {
        "date": datetime.now(UTC).date().isoformat(),
        "machine": f"{_processor()}, {os.cpu_count()} cores, one thread per side, {platform.system()}",
        "python": platform.python_version(),
        "versions": versions,
    }


def _processor() -> str:
    models = Path("/proc/cpuinfo")
    if models.is_file():
        for line in models.read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return f"{line.partition(':')[2].strip()} ({platform.machine()})"
    return platform.machine()


def as_json(where: dict[str, Any], tables: dict[str, Table]) -> dict[str, Any]:
    """One document: the conditions, and the rows of every table by column."""
    return {
        **where,
        "benchmarks": {
            name: {
                "title": table.title,
                "note": table.note,
                "rows": [dict(zip(table.columns, row, strict=True)) for row in table.rows],
                "claims": [
                    {"text": c.text, "value": c.value, "relation": c.relation, "bound": c.bound, "met": c.met}
                    for c in table.claims
                ],
            }
            for name, table in tables.items()
        },
    }


def as_markdown(where: dict[str, Any], tables: dict[str, Table]) -> str:
    """A page: what was asked first, then the tables."""
    packages = ", ".join(f"{name} {number}" for name, number in where["versions"].items())
    lines = [
        f"# Benchmarks, {where['date']}",
        "",
        f"{where['machine']}; Python {where['python']}, {packages}.",
        "Times are medians.",
    ]
    claims = [claim for table in tables.values() for claim in table.claims]
    if claims:
        lines += ["", "| asked | measured | wanted | |", "| --- | ---: | ---: | --- |"]
        lines += [
            f"| {c.text} | {_text(c.value)} | {c.relation} {_text(c.bound)} | {'met' if c.met else 'MISSED'} |"
            for c in claims
        ]
    for table in tables.values():
        lines += ["", f"## {table.title}", "", table.note, "", _row(table.columns)]
        numeric = [all(not isinstance(row[i], str) for row in table.rows) for i in range(len(table.columns))]
        lines.append(_row("---:" if n else "---" for n in numeric))
        lines += [_row(_text(cell) for cell in row) for row in table.rows]
    return "\n".join(lines) + "\n"


def _row(cells: Iterable[str]) -> str:
    return f"| {' | '.join(cells)} |"


def _text(cell: Cell) -> str:
    if not isinstance(cell, float):
        return str(cell)
    return f"{cell:.3g}" if abs(cell) < 1000 else f"{cell:.0f}"
