"""Zonotope and strip: how much larger the enclosure is than the intersection, ``tight`` and ``frobenius``."""

from functools import partial

import numpy as np
from shapely import area, intersection, polygons

from benchmarks.families import CUT_FAMILIES, Cuts, cuts
from benchmarks.report import Cell, Claim, Table
from benchmarks.timing import median_seconds
from reach_server.numeric.types import FloatArray
from reach_server.sets.halfspace import StripMethod

METHODS: tuple[StripMethod, ...] = ("tight", "frobenius")


def run(quick: bool) -> Table:
    """Areas over the exact ones (polygon clipping by Shapely), and the time of one cut."""
    pairs = 200 if quick else 2000
    rows: list[tuple[Cell, ...]] = []
    larger = 0.0
    ratios: dict[str, list[FloatArray]] = {method: [] for method in METHODS}
    for name in CUT_FAMILIES:
        family = cuts(name, pairs)
        exact = exact_area(family)
        before = family.zonotopes.volume()
        for method in METHODS:
            cut = partial(_area_after, family, method)
            after = cut()
            ratios[method].append(after / exact)
            enlarged = 100 * float(np.mean(after > before * (1 + 1e-9)))
            if method == "tight":
                larger = max(larger, enlarged)
            rows.append((
                name, method, float(np.median(after / exact)), float(np.quantile(after / exact, 0.9)), enlarged,
                median_seconds(cut, 3) / pairs * 1e6,
            ))  # fmt: skip
    generic = float(np.median(ratios["tight"][0]))
    pooled = float(np.median(np.concatenate(ratios["tight"])))
    return Table(
        "Zonotope and strip",
        f"{pairs} planar pairs per family, 6 generators. Half-width of the strip relative to that of the set: 0.05 to "
        "0.6 (*generic*; *correlated*: sets 100 times as long as wide), 0.001 to 0.02 (*thin*), 0.6 to 1.2 (*wide*). "
        "Area of the zonotope after the cut over that of the exact intersection; `frobenius`: the paper's Algorithm 2.",
        ("family", "method", "area over exact, median", "90 %", "larger than before %", "µs a cut (with its area)"),
        rows,
        [
            Claim("strip, generic pairs: median area of `tight` over exact", generic, "≤", 1.2),
            Claim("strip, all families: median area of `tight` over exact", pooled, "≤", 1.2),
            Claim("strip: % of `tight` cuts that enlarge the set", larger, "≤", 0.0),
        ],
        keys=2,
    )


def _area_after(family: Cuts, method: StripMethod) -> FloatArray:
    return family.zonotopes.intersect_strip(family.normal, family.middle, family.radius, method).volume()


def exact_area(family: Cuts) -> FloatArray:
    """Areas (P,) of zonotope and strip, by polygon clipping."""
    zonotopes = family.zonotopes
    length = np.linalg.norm(family.normal, axis=1, keepdims=True)
    unit = family.normal / length
    along = np.stack([-unit[:, 1], unit[:, 0]], axis=1)
    reach = 2 * np.abs(zonotopes.generators).sum(axis=(1, 2))[:, None]
    middle, half = unit * family.middle[:, None] / length, unit * family.radius[:, None] / length
    corners = [middle + a * half + b * reach * along for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
    bands = polygons(np.stack(corners, axis=1))
    return np.asarray(area(intersection(polygons(zonotopes.polygon()), bands)))
