"""Side information: how long formulas take to follow, and predicates to cut."""

import time
from collections.abc import Callable

import numpy as np

from benchmarks.report import Cell, Claim, Table
from benchmarks.timing import median_seconds
from reach_server.predicates import Context, Literals
from side_info import Scenario
from side_info.progression import Grid, frontier
from side_info.progression import Table as Obligations
from side_info.stl.nnf import Conjunction, Finally, Literal, Normal

SECOND = 10**9
VEHICLES = 1000


def run(quick: bool) -> Table:
    """Milliseconds for tables that are made once, and for what a round of 1000 vehicles asks of them."""
    vehicles = 50 if quick else VEHICLES
    phi_p = Scenario.load("parking-lot").side_information
    six = Conjunction(tuple(Finally(0, 20 * SECOND, Literal(i)) for i in range(6)))
    rows: list[tuple[Cell, ...]] = []

    def followed(formula: Normal, steps: int) -> tuple[float, Obligations, int]:
        seconds = []
        for _ in range(3):
            table = Obligations()
            began = time.perf_counter()
            root = table.add(formula, Grid(SECOND), lambda predicate, _: predicate)
            frontier(table, root, steps)
            seconds.append(time.perf_counter() - began)
        return float(np.median(seconds)), table, root

    first, table, root = followed(phi_p, 41)
    rows.append(("formula of the parking lot, 41 steps, first time", first * 1e3, len(table)))
    again = median_seconds(lambda: frontier(table, root, 41), 20)
    rows.append(("the same once more", again * 1e3, len(table)))
    seconds, many, _ = followed(six, 21)
    most = max(len(many.alternatives(o)) for o in range(len(many)))
    rows.append((f"six independent eventually, 21 steps, at most {most} alternatives", seconds * 1e3, len(many)))
    obligations = np.full(vehicles, root)
    rows.append(
        (f"alternatives of {vehicles} vehicles", median_seconds(lambda: table.expand(obligations), 20) * 1e3, 1)
    )
    for name, cut, count in _cuts(vehicles):
        rows.append((f"{name}, {vehicles} sets", median_seconds(cut, 10) * 1e3, count))
    return Table(
        "Following formulas, cutting by predicates",
        "Tables of obligations are made once for a vehicle class and shared by its vehicles. 'Size': obligations in "
        "the table, or strips of a cut. The disc is cut by its tangents; the others are linearised on every set.",
        ("what", "ms", "size"),
        rows,
        [
            Claim("formula of the parking lot over 41 steps, first time, ms", first * 1e3, "≤", 5.0),
            Claim("six independent eventually: alternatives at one step", float(most), "≤", 64.0),
        ],
    )


def _cuts(vehicles: int) -> list[tuple[str, Callable[[], object], int]]:
    rng = np.random.default_rng(0)
    center = rng.uniform(-2, 2, (vehicles, 4))
    generators = 0.1 * rng.normal(size=(vehicles, 4, 12))
    zero = np.zeros(vehicles)
    context = Context(zero + 0.1, zero + 2, zero, center - 0.01, center + 0.01)
    index = {"x1": 0, "x2": 1, "yaw": 2, "v": 3}
    found: list[tuple[str, Callable[[], object], int]] = []
    for title, formula in (
        ("strip", "abs(x1 + x2) <= 1"),
        ("disc", "norm(x1 - 0.3, x2) <= 1.4"),
        ("lateral acceleration", "v^2 * tan(yaw / 4) <= 1"),
        ("motion from the last sample", "cos(last(yaw)) * (x2 - last(x2)) - sin(last(yaw)) * (x1 - last(x1)) <= 0.1"),
    ):
        scenario = Scenario.parse(
            "scenario: s\nversion: 1\nstate: {x1: m, x2: m, yaw: rad, v: m/s}\ntime: {zero: on_start}\n"
            f"assume: 'always[0:9 s]({formula})'\n"
        )
        literals = Literals(4, (0, 1), np.zeros((4, 0)))
        literal = literals.add(scenario.predicates[0], index, scenario="s", name=title)

        def cut(literals: Literals = literals, literal: int = literal) -> object:
            return literals.strips(literal, center, generators, context)

        found.append((title, cut, literals.strips(literal, center, generators, context)[0].lower.shape[-1]))
    return found
