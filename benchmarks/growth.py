"""How the cost of an operation grows with generators, constraints, dimension and batch."""

from collections.abc import Callable

import numpy as np
from matplotlib.figure import Figure

from benchmarks import plots
from benchmarks.families import Sets, random_rows
from benchmarks.report import Cell, Table
from benchmarks.timing import seconds, spread
from reach_server.sets import ConstrainedZonotope, Zonotope

GENERATORS, CONSTRAINTS, DIMENSION, BATCH = 40, 4, 2, 100
AXES: dict[str, tuple[int, ...]] = {
    "generators": (10, 20, 40, 80, 160),
    "constraints": (1, 2, 4, 8, 16),
    "dimension": (2, 3, 4, 6, 8),
    "batch": (1, 10, 100, 1000, 10000),
}
UNITS = {"generators": "g", "constraints": "c", "dimension": "n", "batch": "sets"}


def _plain(z: ConstrainedZonotope) -> Zonotope:
    return Zonotope(z.center, z.generators)


#: What is timed: prepares a call on a batch of sets, or None where the operation is not for them.
OPERATIONS: dict[str, Callable[[ConstrainedZonotope], Callable[[], object] | None]] = {
    "linear map and sum": lambda z: lambda: z.linear_map(np.eye(z.dimension)).minkowski_sum(z),
    "reduce_order": lambda z: lambda: z.reduce_order(3),
    "strip, zonotope (tight)": lambda z: lambda: _plain(z).intersect_strip(np.ones(z.dimension), 0.0, 1.0),
    "strip, constrained (exact)": lambda z: lambda: z.intersect_strip(np.ones(z.dimension), 0.0, 1.0),
    "support (certified)": lambda z: lambda: z.support(np.ones((1, z.dimension))),
    "is_empty": lambda z: z.is_empty,
    "reduce_constraints by 1": lambda z: lambda: z.reduce_constraints(z.constraint_matrix.shape[-2] - 1),
    "outline (exact)": lambda z: z.polygon if z.dimension == 2 else None,
}
#: In larger batches these would take minutes and say nothing new.
SLOW, LARGEST = ("outline (exact)", "reduce_constraints by 1"), 1000


def run(quick: bool) -> Table:
    """Microseconds a set, each number varied alone."""
    rows: list[tuple[Cell, ...]] = []
    for axis, values in AXES.items():
        for value in values[:3] if quick else values:
            sizes = {"generators": GENERATORS, "constraints": CONSTRAINTS, "dimension": DIMENSION, "batch": BATCH}
            sizes[axis] = value
            sets = random_rows(sizes["batch"], sizes["generators"], sizes["constraints"], dimension=sizes["dimension"])
            for name, times in _times(sets, 1 if quick else 5).items():
                rows.append((axis, value, name, *spread(times, 1e6 / len(sets))))
    return Table(
        "How the cost of set operations grows",
        f"Constrained zonotopes with random rows; where not varied {GENERATORS} generators, {CONSTRAINTS} constraints, "
        f"dimension {DIMENSION}, a batch of {BATCH}. Time by the number of sets in the batch.",
        ("varied", "to", "operation", "µs a set", "25 %", "75 %"),
        rows,
        keys=3,
    )


def _times(sets: Sets, repeats: int) -> dict[str, list[float]]:
    together = sets.all()
    found = {}
    for name, prepare in OPERATIONS.items():
        call = prepare(together)
        if call is not None and (name not in SLOW or len(sets) <= LARGEST):
            call()
            found[name] = [seconds(call)[0] for _ in range(repeats)]
    return found


def plot(table: Table) -> Figure:
    """A panel for each number that is varied."""
    made = plots.figure(10, 7.5)
    grid = made.subplots(2, 2, sharey=True)
    for place, axis in zip(grid.flat, AXES, strict=True):
        plots.curves(place, plots.lines(table, axis), f"{axis} ({UNITS[axis]})", "µs a set", log=True)
    handles, labels = grid.flat[-1].get_legend_handles_labels()
    made.legend(handles, labels, loc="outside lower center", ncols=4, frameon=False)
    return made
