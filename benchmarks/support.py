"""Support of constrained zonotopes: certified by duality, ZonoOpt, and HiGHS, on the same sets and direction."""

import numpy as np
from matplotlib.figure import Figure

from benchmarks.families import Sets, random_rows, strip_cuts
from benchmarks.peers import REFERENCE, Program, linprog_support, zonoopt_set, zonoopt_settings
from benchmarks.plots import bars
from benchmarks.report import Cell, Claim, Table
from benchmarks.timing import repeated, spread, times_of_calls
from reach_server.numeric.types import FloatArray

#: Least difference, in half-widths of the set, that counts as below: what the reference itself may be off.
BELOW = 1e-9
DIRECTION = np.array([1.0, 0.0])
NEARBY = np.array([np.cos(0.2), np.sin(0.2)])


def run(quick: bool) -> Table:
    """Time of one value; how often it is below that of the linear program; by how much it differs."""
    count = 100 if quick else 1000
    families = (random_rows(count, 40, 4), random_rows(count, 40, 10), strip_cuts(count, 40, 4))
    rows: list[tuple[Cell, ...]] = []
    claims: list[Claim] = []
    for sets in families:
        _measure(sets, quick, rows, claims)
    return Table(
        "Support of constrained zonotopes",
        f"{count} planar sets per family, direction (1, 0), objects made beforehand. 'A call' is the median over the "
        "sets, each asked alone; of the batch, the time by its number. 'Below' counts values less than that of the "
        f"linear program (HiGHS at {REFERENCE:g}) by more than {BELOW:g} half-widths of the set: taken as bounds they "
        "lose points. 'Off' is the distance to it in half-widths. *Warm* starts from the optimal basis for a direction "
        "0.2 rad away.",
        (
            "family",
            "method",
            "µs a call",
            "25 %",
            "75 %",
            "times ours alone",
            "times ours in the batch",
            "below %",
            "off, median",
            "off, most",
        ),
        rows,
        claims,
        keys=2,
    )


def _measure(sets: Sets, quick: bool, rows: list[tuple[Cell, ...]], claims: list[Claim]) -> None:
    count = len(sets)
    programs = [Program(sets, i, REFERENCE) for i in range(count)]
    exact = np.array([p.support(DIRECTION) for p in programs])
    half_width = (exact + np.array([p.support(-DIRECTION) for p in programs])) / 2
    direction = DIRECTION[None]
    together, singles = sets.all(), [sets.one(i) for i in range(count)]

    batch = repeated(lambda: together.support(direction), 3 if quick else 20)
    values = together.support(direction)[:, 0]
    single, single_values = times_of_calls(lambda s: float(s.support(direction)[0]), singles)

    peers = [zonoopt_set(sets, i) for i in range(count)]
    tight = zonoopt_settings(1e-9)
    theirs, their_values = times_of_calls(lambda z: float(z.support(DIRECTION)), peers)
    few = peers[: max(count // 5, 20)]
    slow, slow_values = times_of_calls(lambda z: float(z.support(DIRECTION, settings=tight)), few)
    scipy, scipy_values = times_of_calls(lambda i: linprog_support(sets, i, DIRECTION), range(count))
    programs = [Program(sets, i) for i in range(count)]
    for program in programs:
        program.support(NEARBY)
    warm, warm_values = times_of_calls(lambda p: p.support(DIRECTION), programs)

    alone, each = float(np.median(single)), float(np.median(batch)) / count

    def add(method: str, times: list[float], found: FloatArray, number: int = 1) -> float:
        off = (found - exact[: len(found)]) / half_width[: len(found)]
        below = float((off < -BELOW).mean())
        middle, low, high = spread(times, 1e6 / number)
        rows.append((
            sets.name, method, middle, low, high, middle / alone / 1e6, middle / each / 1e6, 100 * below,
            float(np.median(np.abs(off))), float(np.abs(off).max()),
        ))  # fmt: skip
        return below

    below = add(f"certified, batch of {count}", batch, values, count)
    below = max(below, add("certified, batch of 1", single, np.array(single_values)))
    add("ZonoOpt, default", theirs, np.array(their_values))
    add("ZonoOpt, tolerance 1e-9", slow, np.array(slow_values))
    add("HiGHS by linprog", scipy, np.array(scipy_values))
    add("HiGHS, warm", warm, np.array(warm_values))
    peer = float(np.median(theirs))
    claims += [
        Claim(f"support, {sets.name}: times faster than ZonoOpt, batch of {count}", peer / each, "≥", 20.0),
        Claim(f"support, {sets.name}: times faster than ZonoOpt, one set", peer / alone, "≥", 20.0),
        Claim(f"support, {sets.name}: % of values below the linear program", 100 * below, "≤", 0.0),
    ]


def plot(table: Table) -> Figure:
    """Each method, by family."""
    return bars(table, lambda row: str(row[0]), lambda row: str(row[1]), 2, "µs a call; of a batch, by its number")
