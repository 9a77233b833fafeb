"""One update of the engine, a sample in and a tube out, beside the published form of the algorithm."""

import gc
import tracemalloc
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import count

import numpy as np
from matplotlib.figure import Figure

from benchmarks import published
from benchmarks.plots import bars
from benchmarks.report import Cell, Claim, Table
from benchmarks.timing import seconds, spread, swept
from fleet_lab import fleets
from fleet_lab.fleets import Drives
from reach_server.engine.engine import Engine, PlannedInputs
from reach_server.engine.results import Tubes

WINDOW, HORIZON, PREDICATES = 1000, 10, 2
METHODS = ("calibrated", "paper", "set_membership")
#: Updates before the first that counts: every vehicle has been fitted, and fitted again, by then.
WARM_UP = 25
#: Asked for by method: µs a vehicle in a batch of 1000.
WANTED = {"calibrated": 35.0, "paper": 35.0, "set_membership": 150.0}


#: Samples that are taken in at once while the windows fill.
CHUNK = 64


@dataclass(frozen=True, slots=True)
class Times:
    """Seconds of single updates of all vehicles together, and the newest tubes."""

    seconds: tuple[float, ...]
    newest: Tubes

    @property
    def longest(self) -> float:
        """The longest update over the median one."""
        return max(self.seconds) / float(np.median(self.seconds))


def measure(drives: Drives, vehicles: int, method: str, predicates: int = PREDICATES, updates: int = 30) -> Times:
    """Fill the windows of ``vehicles`` vehicles, then time ``updates`` updates, each of all of them in one call."""
    times = []
    with swept():
        update = _updates(drives, vehicles, method, predicates, updates)
        for _ in range(updates):
            took, tubes = seconds(update)
            times.append(took)
    if len(tubes.vehicles) != vehicles or tubes.events:
        raise RuntimeError(f"{len(tubes.vehicles)} of {vehicles} tubes, events {tubes.events[:3]}")
    return Times(tuple(times), tubes)


def bytes_each(drives: Drives, vehicles: int, method: str) -> float:
    """Bytes held for each vehicle after the same updates; apart from the times, which tracing would spoil."""
    gc.collect()
    tracemalloc.start()
    update = _updates(drives, vehicles, method, PREDICATES, 0)
    gc.collect()
    held = tracemalloc.get_traced_memory()[0]
    tracemalloc.stop()
    del update
    return held / vehicles


def _updates(drives: Drives, vehicles: int, method: str, predicates: int, later: int) -> Callable[[], Tubes]:
    """The next update of an engine whose windows are full, and which leaves ``later`` samples to come."""
    engine = Engine(drives.profile, method=method, planned=True)
    scenario = drives.scenario(predicates) if predicates else None
    for number in range(vehicles):
        engine.add(f"vehicle-{number}")
        if scenario is not None:
            engine.assign(f"vehicle-{number}", scenario, fleets.START)
    first = drives.truth.shape[1] - drives.profile.horizon - WARM_UP - later
    for k in range(0, first, CHUNK):
        engine.append(drives.batch(vehicles, k, min(k + CHUNK, first)))
    moments = count(first)
    exactly = np.zeros((vehicles, drives.inputs.shape[2]))

    def update() -> Tubes:
        k = next(moments)
        return engine.step(drives.batch(vehicles, k), PlannedInputs(drives.plan(vehicles, k), exactly))

    for _ in range(WARM_UP):
        update()
    return update


def samples(window: int, horizon: int, updates: int) -> int:
    """Samples that a measurement takes: the window is full, and has moved on, before the first update."""
    return window + 2 * horizon + 40 + WARM_UP + updates


def run(quick: bool) -> Table:
    """Microseconds a vehicle and update, by method and number of vehicles."""
    sizes = (1, 4) if quick else (1, 10, 100, 1000)
    window, updates = (400, 5) if quick else (WINDOW, 40)
    drives = fleets.cars(samples(window, HORIZON, updates), window=window, horizon=HORIZON)
    rows: list[tuple[Cell, ...]] = []
    claims: list[Claim] = []
    alone = {}

    def add(method: str, cuts: str, vehicles: int, found: Times, held: float | None) -> None:
        cut = float((found.newest.area / found.newest.area_free).mean())
        rows.append((method, cuts, vehicles, *spread(found.seconds, 1e6 / vehicles), found.longest, held, cut))

    for method in METHODS:
        for vehicles in sizes:
            found = measure(drives, vehicles, method, updates=updates)
            # One vehicle alone pays for the tables that all share.
            held = None if quick or vehicles == 1 else bytes_each(drives, vehicles, method) / 1000
            add(method, "zonotope", vehicles, found, held)
            each = float(np.median(found.seconds)) / vehicles * 1e6
            if vehicles == 1:
                alone[method] = each
                claims.append(Claim(f"{method}, one vehicle alone, µs", each, "≤", 1500.0))
            if vehicles == 1000:
                claims.append(Claim(f"{method}, 1000 vehicles, µs a vehicle", each, "≤", WANTED[method]))
                claims.append(Claim(f"{method}, 1000 vehicles, longest update over median", found.longest, "≤", 2.0))
                claims.append(Claim(f"{method}, 1000 vehicles, kB a vehicle", held, "≤", 300.0))
    constrained = replace(drives, profile=drives.profile.model_copy(update={"cuts": "constrained"}))
    add("set_membership", "constrained", sizes[-2], measure(constrained, sizes[-2], "set_membership", updates=5), None)
    for name, matrix_zonotope in (("as published", True), ("as published, no matrix zonotope", False)):
        times = published_seconds(drives, 1 if quick else 7, matrix_zonotope=matrix_zonotope)
        middle = float(np.median(times))
        rows.append((name, "zonotope", 1, *spread(times, 1e6), max(times) / middle, None, None))
        # The algorithm needs no matrix zonotope: only without is it a rival.
        if not matrix_zonotope:
            ratio = middle * 1e6 / alone["paper"]
            claims.append(Claim(f"{name}: its time over that of paper, one vehicle", ratio, "≥", 1.0))
    return Table(
        "One update",
        f"A sample in, a tube of {HORIZON} steps out with its outlines, areas, boxes, verdicts and audit; window of "
        f"{window}, 4 states, 2 inputs, {fleets.LAGS} lags, {PREDICATES} predicates at every step, a known plan. "
        "'Longest' is the longest update over the median one, refits included; 'kB' what Python and NumPy hold a "
        "vehicle; 'area' that with side information over that without. 'As published' is one vehicle's update with a "
        "pseudoinverse at every step, from its data matrices on: no message, window, outline or audit. It uses "
        "only the center of the matrix zonotope of the noise, so the row without it is the fair one to compare with; "
        "the other builds all its generators once an update, as a literal reading does. Z_ε is zero on both sides: the "
        "method `paper` fits in the world frame, where bounds of slopes in the car's frame say nothing.",
        ("method", "cuts", "vehicles", "µs a vehicle", "25 %", "75 %", "longest", "kB a vehicle", "area"),
        rows,
        claims,
        keys=3,
    )


def published_seconds(drives: Drives, repeats: int, *, matrix_zonotope: bool) -> list[float]:
    """Seconds of updates of one vehicle in the published form, with window and horizon of the drives' profile."""
    window = drives.profile.window
    x, u = drives.measured[0], drives.inputs[0]
    lagged = np.concatenate([np.roll(u, lag, axis=0) for lag in range(fleets.LAGS + 1)], axis=1)[fleets.LAGS : window]
    process, measurement = drives.profile.noise.process, drives.profile.noise.measurement
    assert process is not None
    assert measurement is not None
    plan = np.repeat(lagged[-1:], drives.profile.horizon, axis=0)
    strips = [(np.eye(4)[1], 0.0, 0.15), (np.eye(4)[3], 1.0, 0.06)]
    data = x[fleets.LAGS : window].T, lagged.T, x[fleets.LAGS + 1 : window + 1].T
    start, noise = (x[window - 1], measurement.matrix()), (np.zeros(4), process.matrix())

    def update() -> object:
        return published.tube(*data, start, plan, noise, np.zeros(4), strips, 40, matrix_zonotope=matrix_zonotope)

    update()
    return [seconds(update)[0] for _ in range(repeats)]


def plot(table: Table) -> Figure:
    """Each method and number of vehicles."""
    return bars(
        table,
        lambda row: f"{row[2]} vehicle{'' if row[2] == 1 else 's'}",
        lambda row: str(row[0]) if row[1] == "zonotope" else f"{row[0]}, cuts {row[1]}",
        3,
        "µs a vehicle and update",
    )
