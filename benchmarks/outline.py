"""Exact planar outlines of constrained zonotopes, here and by ``zonoopt.get_vertices``."""

import numpy as np
import zonoopt

from benchmarks.families import Floats, Sets, random_rows, strip_cuts
from benchmarks.peers import zonoopt_set
from benchmarks.report import Cell, Claim, Table
from benchmarks.timing import median_call, median_seconds
from reach_server.sets.planar import polygon_area

DIRECTIONS = 32


def run(quick: bool) -> Table:
    """Time of one outline, its vertices, and its area over that by ZonoOpt."""
    count = 1 if quick else 5
    rows: list[tuple[Cell, ...]] = []
    claims: list[Claim] = []
    for sets in (random_rows(100, 40, 10), strip_cuts(100, 40, 10)):
        _measure(sets, count, quick, rows, claims)
    return Table(
        "Planar outline of constrained zonotopes",
        f"Median over {count} sets of each family (ZonoOpt takes seconds for one); a batch holds 100, by their number. "
        "ZonoOpt solves linear programs and takes the convex hull of their optima; it knows no batches.",
        ("family", "method", "ms a set", "times ours", "vertices, median", "area over ZonoOpt's"),
        rows,
        claims,
    )


def _measure(sets: Sets, count: int, quick: bool, rows: list[tuple[Cell, ...]], claims: list[Claim]) -> None:
    theirs, polygons = median_call(
        lambda z: np.asarray(zonoopt.get_vertices(z)), [zonoopt_set(sets, i) for i in range(count)]
    )
    singles = [sets.one(i) for i in range(count)]
    ours = float(np.median([median_seconds(s.polygon, 2 if quick else 20) for s in singles]))
    together = sets.all()
    batch = median_seconds(together.polygon, 1 if quick else 5) / len(sets)
    coarse = median_seconds(lambda: together.polygon(DIRECTIONS), 1 if quick else 5) / len(sets)
    peer_area = np.array([abs(float(polygon_area(p))) for p in polygons])

    def add(method: str, time: float, found: list[Floats]) -> None:
        ratio = np.array([float(polygon_area(p)) for p in found]) / peer_area
        corners = float(np.median([len(np.unique(np.round(p, 9), axis=0)) for p in found]))
        rows.append((sets.name, method, time * 1e3, time / ours, corners, float(np.median(ratio))))

    add("exact", ours, [s.polygon() for s in singles])
    add("exact, batch of 100", batch, list(together.polygon()[:count]))
    add(f"{DIRECTIONS} certified directions, batch of 100", coarse, list(together.polygon(DIRECTIONS)[:count]))
    add("zonoopt.get_vertices", theirs, polygons)
    claims.append(Claim(f"outline, {sets.name}: times faster than zonoopt.get_vertices", theirs / ours, "≥", 100.0))
