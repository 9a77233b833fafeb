"""Certified supports against linear programs, and tight strips against the paper's."""

import numpy as np
from scipy.optimize import linprog

from benchmarks.timing import median_seconds
from reach_server.sets import ConstrainedZonotope, Zonotope
from reach_server.sets.planar import clip, polygon_area

SETS, GENERATORS, ROWS = 200, 40, 4
PAIRS = 2000


def supports() -> dict[str, float]:
    """Time of one support bound, batched by duality and one linear program each; the bound's excess over the LP."""
    rng = np.random.default_rng(0)
    inner = rng.uniform(-0.5, 0.5, (SETS, GENERATORS))
    matrix = rng.normal(size=(SETS, ROWS, GENERATORS))
    generators = rng.normal(size=(SETS, 2, GENERATORS))
    offset = (matrix @ inner[..., None])[..., 0]
    sets = ConstrainedZonotope(np.zeros((SETS, 2)), generators, matrix, offset)
    direction = np.array([[1.0, 0.0]])
    exact = np.zeros(SETS)

    def programs() -> None:
        for i in range(SETS):
            result = linprog(-generators[i, 0], A_eq=matrix[i], b_eq=offset[i], bounds=(-1, 1), method="highs")
            exact[i] = -float(result.fun or np.nan)

    dual = median_seconds(lambda: sets.support(direction), 5) / SETS
    lp = median_seconds(programs, 3) / SETS
    excess = sets.support(direction)[:, 0] / exact - 1
    return {
        "certified_us": dual * 1e6,
        "linprog_us": lp * 1e6,
        "ratio": lp / dual,
        "excess_median": float(np.median(excess)),
        "excess_least": float(excess.min()),
    }


def strips() -> dict[str, float]:
    """Area after a cut over the exact area, ``tight`` and ``frobenius`` on the same planar pairs."""
    rng = np.random.default_rng(1)
    zonotopes = Zonotope(np.zeros((PAIRS, 2)), rng.normal(size=(PAIRS, 2, 6)))
    normal = rng.normal(size=(PAIRS, 2))
    reach = np.abs((normal[:, None] @ zonotopes.generators)[:, 0]).sum(axis=1)
    middle, radius = rng.uniform(-0.8, 0.8, PAIRS) * reach, rng.uniform(0.05, 0.6, PAIRS) * reach
    exact = np.zeros(PAIRS)
    for i, polygon in enumerate(zonotopes.polygon()):
        kept = clip(polygon, normal[i], np.array(middle[i] + radius[i]))
        exact[i] = polygon_area(clip(kept, -normal[i], np.array(radius[i] - middle[i])))
    figures: dict[str, float] = {}
    for method in ("tight", "frobenius"):
        area = zonotopes.intersect_strip(normal, middle, radius, method).volume()
        figures[f"{method}_area_median"] = float(np.median(area / exact))
        figures[f"{method}_larger_than_before"] = float(np.mean(area > zonotopes.volume() * (1 + 1e-9)))
    return figures
