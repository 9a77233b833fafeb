"""The report: one JSON document, and the same as Markdown and on the terminal."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from importlib.metadata import version
from typing import Any, Final

from rich.console import Console
from rich.table import Table

from fleet_lab.paper.cells import KINDS, NONE, NONE_RING, PRINTED, Block
from fleet_lab.paper.formulas import FORMULAS

SYMBOLS: Final = {NONE: "none", NONE_RING: "none", **{formula.key: formula.symbol for formula in FORMULAS}}
_BLOCKS: Final = ("printed", "published_code", "printed_text", "ours", "ours_with_noise", "ours_realistic")
_TABLES: Final = (
    ("Table I: parking lot", NONE, ("phi_p", "phi_theta")),
    ("Table II: roundabout", NONE_RING, ("phi_r",)),
)
#: What an area may be above another one, relative: rounding.
_ROUNDING: Final = 1e-9
_PACKAGES: Final = ("numpy", "scipy", "numba", "casadi")


@dataclass(frozen=True, slots=True)
class Claim:
    """A printed figure that the published code's sets come within a part of."""

    formula: str
    kind: str
    within: float


CLAIMS: Final = (
    Claim(NONE, "zonotope", 0.01),
    Claim("phi_theta", "zonotope", 0.01),
    Claim("phi_theta", "constrained", 0.01),
    Claim("phi_p", "constrained", 0.05),
    Claim("phi_r", "constrained", 0.05),
    Claim("phi_r", "zonotope", 0.03),
)


def as_document(
    seed: int, blocks: Sequence[Block], drawn: Sequence[str], pending: Sequence[str], no_recording: str | None
) -> dict[str, Any]:
    """What was computed so far; ``pending`` names what was not."""
    return {
        "complete": not pending,
        "pending": list(pending),
        "date": datetime.now(UTC).isoformat(timespec="seconds"),
        "seed": seed,
        "versions": {name: version(name) for name in _PACKAGES},
        "unit": "m^2",
        "blocks": [_block(block) for block in blocks],
        "claims": _claims(blocks),
        "figures": list(drawn),
        "recording": no_recording,
    }


def _block(block: Block) -> dict[str, Any]:
    cells = [{**asdict(cell), "ratio": cell.ratio, "ratio_printed": cell.ratio_printed} for cell in block.cells]
    return {**asdict(block), "cells": cells}


def _claims(blocks: Sequence[Block]) -> list[dict[str, Any]]:
    cells = {(c.formula, c.kind): c for block in blocks if block.key == "published_code" for c in block.cells}
    found = []
    for claim in CLAIMS:
        cell = cells.get((claim.formula, claim.kind))
        ratio = None if cell is None else cell.ratio_printed
        met = None if ratio is None else abs(ratio - 1) <= claim.within
        found.append({**asdict(claim), "printed": PRINTED[claim.formula, claim.kind], "ratio": ratio, "met": met})
    return found


def failures(document: dict[str, Any]) -> list[str]:
    """What must not be: a simulated state outside of a set that holds it, ours larger than Algorithm 2, a claim that is
    not met."""
    found = []
    for block in document["blocks"]:
        if block["unsound"] or block["key"] in ("recording", "routes"):
            continue
        for cell in block["cells"]:
            where = f"{block['title']}, {SYMBOLS[cell['formula']]}, {cell['kind']}"
            if cell["outside"]:
                found.append(f"{where}: {cell['outside']} of {cell['steps']} states outside")
            if (cell["most_of_algorithm_2"] or 0.0) > 1 + _ROUNDING:
                found.append(f"{where}: a set has {cell['most_of_algorithm_2']:.9g} times the area of Algorithm 2's")
            published = block["key"] in ("published_code", "printed_text") and cell["kind"] == "zonotope"
            if not published and (cell["most_of_uncut"] or 0.0) > 1 + _ROUNDING:
                found.append(f"{where}: a set has {cell['most_of_uncut']:.9g} times its area before any cut")
    for claim in document["claims"]:
        if claim["met"] is False:
            found.append(f"{_claim_text(claim)}: {claim['ratio']:.3f} times the printed figure")
    return found


def _claim_text(claim: dict[str, Any]) -> str:
    return f"{claim['printed']:.3f} ({SYMBOLS[claim['formula']]}, {claim['kind']}) within {claim['within']:.0%}"


def summary_rows(document: dict[str, Any]) -> list[tuple[str, list[list[str]]]]:
    """The tables of the paper with every block beside the printed figures: (title, rows of texts)."""
    blocks = {block["key"]: block for block in document["blocks"]}
    tables = []
    for title, none, formulas in _TABLES:
        rows = []
        for key in _BLOCKS:
            if key not in blocks:
                continue
            cells = {(c["formula"], c["kind"]): c for c in blocks[key]["cells"]}
            row = [blocks[key]["title"], area_text(cells[none, "zonotope"]["area"])]
            for formula in formulas:
                row.append(" / ".join(area_text(cells[formula, kind]["area"]) for kind in KINDS))
            counted = [c for (f, _), c in cells.items() if f in (*formulas, none) and c["steps"]]
            outside, steps = sum(c["outside"] for c in counted), sum(c["steps"] for c in counted)
            rows.append([*row, f"{outside} / {steps}" if counted else "–"])
        tables.append((title, rows))
    return tables


def _header(formulas: Sequence[str]) -> list[str]:
    return ["m², zonotope / constrained", "none", *(SYMBOLS[f] for f in formulas), "outside"]


def print_summary(console: Console, document: dict[str, Any]) -> None:
    """The tables, the claims and what failed."""
    for (title, rows), (_, _, formulas) in zip(summary_rows(document), _TABLES, strict=True):
        table = Table(title=title)
        for i, name in enumerate(_header(formulas)):
            table.add_column(name, justify="right" if i else "left")
        for row in rows:
            table.add_row(*row)
        console.print(table)
    for line in _conclusions(document):
        console.print(line, highlight=False)


def _conclusions(document: dict[str, Any]) -> list[str]:
    lines = []
    met = [_claim_text(claim) for claim in document["claims"] if claim["met"]]
    if met:
        lines.append(f"Reached by the published code's sets: {'; '.join(met)}. 9.311 (φ_p, zonotope) is not reached.")
    for block in document["blocks"]:
        if block["unsound"]:
            lost = ", ".join(f"{cell['outside']} of {cell['steps']}" for cell in block["cells"])
            lines.append(f"Demonstrations of unsoundness, states outside on purpose: {lost}.")
    lines += [f"FAILED: {text}" for text in failures(document)]
    if document["pending"]:
        lines.append(f"INCOMPLETE, not done: {', '.join(document['pending'])}.")
    return lines


def as_markdown(document: dict[str, Any]) -> str:
    """The report."""
    versions = ", ".join(f"{name} {number}" for name, number in document["versions"].items())
    state = "" if document["complete"] else f"**INCOMPLETE**: not done: {', '.join(document['pending'])}.\n\n"
    lines = [
        f"# The paper's tables, recomputed\n\n{state}{document['date']}, seed {document['seed']}; {versions}.\n",
        "The recordings of the paper are not public: drives are simulated at 100 Hz, and every area is a mean over "
        "their steps, single-step sets as in the paper. 'Outside' counts true states outside of their set.\n",
    ]
    for (title, rows), (_, _, formulas) in zip(summary_rows(document), _TABLES, strict=True):
        lines += [f"## {title}\n", *_markdown(_header(formulas), rows), ""]
    lines += [f"{line}\n" for line in _conclusions(document)]
    for name in document["figures"]:
        if name.endswith(".png"):
            lines.append(f"![{name.removesuffix('.png')}]({name})\n")
    for block in document["blocks"]:
        if block["key"] != "printed":
            lines += _block_section(block)
    if document["recording"] is not None:
        lines.append(f"## Over a recording\n\n{document['recording']}\n")
    return "\n".join(lines)


def _block_section(block: dict[str, Any]) -> list[str]:
    header = ["formula", "set", "m²", "by drive", "of uncut", "printed", "of printed", "Algorithm 2", "outside",
              "µs", "note"]  # fmt: skip
    rows = []
    for cell in block["cells"]:
        each = cell["by_drive"]
        rows.append([
            SYMBOLS[cell["formula"]], cell["kind"], area_text(cell["area"]),
            f"{area_text(min(each))} – {area_text(max(each))}" if len(each) > 1 else "",
            _number(cell["ratio"], ".4f"), _number(cell["printed"], ".3f"), _number(cell["ratio_printed"], ".3f"),
            area_text(cell["algorithm_2"]) if cell["algorithm_2"] is not None else "",
            f"{cell['outside']} / {cell['steps']}" if cell["steps"] else "",
            _number(cell["microseconds"], ".3g"), cell["note"],
        ])  # fmt: skip
    lines = [f"## {block['title']}\n", f"{block['note']}\n", *_markdown(header, rows), ""]
    if block["extra"]:
        lines += _recorded_tables(block["extra"])
    return lines


def _recorded_tables(extra: dict[str, Any]) -> list[str]:
    placed = [
        [SYMBOLS[row["formula"]], row.get("left_out", ""), _number(row.get("size"), ".2f"),
         _number(row.get("stretch"), ".2f"), _number(row.get("turn"), ".0f")]
        for row in extra["placed"]
    ]  # fmt: skip
    lines = [
        "Where the scenarios were laid: regions this many times as large, windows as long as in the paper.\n",
        *_markdown(["formula", "left out", "size", "windows", "θ_c in degrees"], placed),
        "",
        f"What the reach server makes of the same drive (profile {extra['profile']}, its own method): measured states "
        "inside, sets with and without side information.\n",
    ]
    served = [
        [SYMBOLS[row["formula"]], str(row["step"]), area_text(row["area"]), area_text(row["area_free"]),
         f"{row['inside']} / {row['checked']}", f"{row['inside_free']} / {row['checked']}",
         ", ".join(f"{label} {count}" for label, count in row["labels"].items()), f"{row['microseconds']:.0f}"]
        for row in extra["served"]
    ]  # fmt: skip
    header = ["formula", "step", "m²", "m² without", "inside", "inside without", "labels", "µs an update"]
    return [*lines, *_markdown(header, served), ""]


def _markdown(header: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    lines = [header, ["---"] * len(header), *rows]
    return [f"| {' | '.join(line)} |" for line in lines]


def area_text(area: float | None) -> str:
    """An area in m² with as many digits as the paper has, small ones with three."""
    if area is None:
        return "–"
    return f"{area:.3f}" if area >= 0.01 else f"{area:.3g}"


def _number(value: float | None, form: str) -> str:
    return "" if value is None else format(value, form)
