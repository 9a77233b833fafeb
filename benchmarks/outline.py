"""Exact planar outlines of constrained zonotopes, here and by ``zonoopt.get_vertices``."""

import numpy as np
import zonoopt

from benchmarks.families import Sets, random_rows, strip_cuts
from benchmarks.peers import zonoopt_set
from benchmarks.report import Cell, Claim, Table
from benchmarks.timing import median_seconds, repeated, spread, times_of_calls
from reach_server.numeric.types import FloatArray
from reach_server.sets.polygon import polygon_area

DIRECTIONS = 32


def run(quick: bool) -> Table:
    """Time of one outline, its vertices, and its area over that by ZonoOpt."""
    count, number, generators, rows_each = (1, 10, 16, 4) if quick else (5, 100, 40, 10)
    rows: list[tuple[Cell, ...]] = []
    claims: list[Claim] = []
    for sets in (random_rows(number, generators, rows_each), strip_cuts(number, generators, rows_each)):
        _measure(sets, count, quick, rows, claims)
    return Table(
        "Planar outline of constrained zonotopes",
        f"Median over {count} sets of each family (ZonoOpt takes seconds for one); a batch holds {number}, by their "
        "number. ZonoOpt solves linear programs and takes the convex hull of their optima; it knows no batches.",
        ("family", "method", "ms a set", "25 %", "75 %", "times ours", "vertices, median", "area over ZonoOpt's"),
        rows,
        claims,
        keys=2,
    )


def _measure(sets: Sets, count: int, quick: bool, rows: list[tuple[Cell, ...]], claims: list[Claim]) -> None:
    theirs, polygons = times_of_calls(
        lambda z: np.asarray(zonoopt.get_vertices(z)), [zonoopt_set(sets, i) for i in range(count)]
    )
    singles = [sets.one(i) for i in range(count)]
    ours = [median_seconds(s.polygon, 2 if quick else 20) for s in singles]
    together = sets.all()
    repeats = 1 if quick else 5
    batch = repeated(together.polygon, repeats)
    coarse = repeated(lambda: together.polygon(DIRECTIONS), repeats)
    peer_area = np.array([abs(float(polygon_area(p))) for p in polygons])
    alone = float(np.median(ours))

    def add(method: str, times: list[float], found: list[FloatArray], number: int = 1) -> None:
        ratio = np.array([float(polygon_area(p)) for p in found]) / peer_area
        corners = float(np.median([len(np.unique(np.round(p, 9), axis=0)) for p in found]))
        middle, low, high = spread(times, 1e3 / number)
        rows.append((sets.name, method, middle, low, high, middle / alone / 1e3, corners, float(np.median(ratio))))

    add("exact", ours, [s.polygon() for s in singles])
    add(f"exact, batch of {len(sets)}", batch, list(together.polygon()[:count]), len(sets))
    add(f"{DIRECTIONS} certified directions, batch of {len(sets)}", coarse,
        list(together.polygon(DIRECTIONS)[:count]), len(sets))  # fmt: skip
    add("zonoopt.get_vertices", theirs, polygons)
    faster = float(np.median(theirs)) / alone
    wanted = 2.0 if quick else 100.0
    claims.append(Claim(f"outline, {sets.name}: times faster than zonoopt.get_vertices", faster, "≥", wanted))
