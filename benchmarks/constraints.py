"""Fewer constraints: the area after going from 4 to 1, over the exact area."""

from collections.abc import Callable

import numpy as np

from benchmarks.families import Sets, random_rows, strip_cuts
from benchmarks.peers import zonoopt_set
from benchmarks.report import Cell, Claim, Table
from reach_server.numeric.types import FloatArray
from reach_server.sets import ConstrainedZonotope

ROWS, LEFT = 4, 1
OURS = "rescaled, then Scott"


def run(quick: bool) -> Table:
    """Median area over the exact one, by method and family."""
    count = 20 if quick else 200
    rows: list[tuple[Cell, ...]] = []
    claims: list[Claim] = []
    for sets in (random_rows(count, 12, ROWS), strip_cuts(count, 12, ROWS), strip_cuts(count, 40, ROWS)):
        exact = sets.all().area()
        medians = {}
        for method, reduce in WAYS.items():
            ratio = reduce(sets) / exact
            there = ratio[np.isfinite(ratio)]
            medians[method] = float(np.median(there))
            rows.append((
                sets.name, method, medians[method], float(np.quantile(there, 0.9)), float(there.min()),
                100 * (1 - len(there) / count),
            ))  # fmt: skip
        least = min(float(str(row[4])) for row in rows if row[:2] == (sets.name, OURS))
        claims.append(Claim(f"constraints {ROWS} → {LEFT}, {sets.name}: least area", least, "≥", 1 - 1e-9))
        claims.append(Claim(f"constraints {ROWS} → {LEFT}, {sets.name}: median area", medians[OURS], "≤", 1.5))
    return Table(
        f"Constraint reduction, {ROWS} → {LEFT}",
        f"{count} planar sets per family: exact area of the reduced set over that of the full one. Below 1, points are "
        "lost. 'No set': the result holds NaN; the other columns leave those out.",
        ("family", "method", "area over exact, median", "90 %", "least", "no set %"),
        rows,
        claims,
        keys=2,
    )


def _reduced(sets: Sets) -> FloatArray:
    return sets.all().reduce_constraints(LEFT).area()


def _dropped(sets: Sets) -> FloatArray:
    return sets.all().keep_newest_constraints(LEFT).area()


def _box(sets: Sets) -> FloatArray:
    lower, upper = sets.all().interval_hull()
    return np.asarray((upper - lower).prod(axis=-1))


def _zonoopt(sets: Sets) -> FloatArray:
    found = []
    for i in range(len(sets)):
        z = zonoopt_set(sets, i)
        for _ in range(ROWS - LEFT):
            z = z.constraint_reduction()
        parts = (z.get_c(), z.get_G().toarray(), z.get_A().toarray(), z.get_b())
        whole = all(np.isfinite(part).all() for part in parts)
        found.append(float(ConstrainedZonotope(*parts).area()) if whole else np.nan)
    return np.array(found)


WAYS: dict[str, Callable[[Sets], FloatArray]] = {
    OURS: _reduced,
    "rows dropped": _dropped,
    "certified box (no row left)": _box,
    "zonoopt.constraint_reduction": _zonoopt,
}
