"""One update of the engine, a sample in and a tube out, beside the published form of the algorithm."""

import gc
import tracemalloc
from dataclasses import dataclass, replace
from itertools import count

import numpy as np

from benchmarks import fleets, published
from benchmarks.fleets import Drives
from benchmarks.report import Cell, Claim, Table
from benchmarks.timing import median_seconds, seconds
from reach_server.engine import Engine, KnownInputs
from reach_server.results import Tubes

WINDOW, HORIZON, PREDICATES = 1000, 10, 2
METHODS = ("calibrated", "paper", "set_membership")
#: Updates before the first that counts: every vehicle has been fitted, and fitted again, by then.
WARM_UP = 25
#: Asked for by method: µs a vehicle in a batch of 1000.
WANTED = {"calibrated": 35.0, "paper": 35.0, "set_membership": 150.0}


@dataclass(frozen=True, slots=True)
class Times:
    """Seconds of single updates of all vehicles together, and bytes held a vehicle."""

    seconds: tuple[float, ...]
    bytes_each: float
    newest: Tubes

    @property
    def median(self) -> float:
        """Median of the updates."""
        return float(np.median(self.seconds))


def measure(drives: Drives, vehicles: int, method: str, predicates: int = PREDICATES, updates: int = 30) -> Times:
    """Fill the windows of ``vehicles`` vehicles, then time ``updates`` updates, each of all of them in one call."""
    gc.collect()
    tracemalloc.start()
    engine = Engine(drives.profile, method=method, planned=True)
    scenario = drives.scenario(predicates) if predicates else None
    for number in range(vehicles):
        engine.add(f"vehicle-{number}")
        if scenario is not None:
            engine.assign(f"vehicle-{number}", scenario, fleets.START)
    first = drives.truth.shape[1] - drives.profile.horizon - WARM_UP - updates
    for k in range(first):
        engine.append(drives.batch(vehicles, k))
    moments = count(first)
    exactly = np.zeros((vehicles, drives.inputs.shape[2]))

    def update() -> Tubes:
        k = next(moments)
        return engine.step(drives.batch(vehicles, k), KnownInputs(drives.plan(vehicles, k), exactly))

    for _ in range(WARM_UP):
        update()
    gc.collect()
    held = tracemalloc.get_traced_memory()[0]
    tracemalloc.stop()
    times = []
    for _ in range(updates):
        took, tubes = seconds(update)
        times.append(took)
    if len(tubes.vehicles) != vehicles or tubes.events:
        raise RuntimeError(f"{len(tubes.vehicles)} of {vehicles} tubes, events {tubes.events[:3]}")
    return Times(tuple(times), held / vehicles, tubes)


def samples(window: int, horizon: int, updates: int) -> int:
    """Samples that a measurement takes: the window is full, and has moved on, before the first update."""
    return window + 2 * horizon + 40 + WARM_UP + updates


def run(quick: bool) -> Table:
    """Microseconds a vehicle and update, by method and number of vehicles."""
    sizes = (1, 10) if quick else (1, 10, 100, 1000)
    window, updates = (400, 10) if quick else (WINDOW, 40)
    drives = fleets.cars(samples(window, HORIZON, updates), window=window, horizon=HORIZON)
    rows: list[tuple[Cell, ...]] = []
    claims: list[Claim] = []
    alone = {}
    for method in METHODS:
        for vehicles in sizes:
            found = measure(drives, vehicles, method, updates=updates)
            each = found.median / vehicles * 1e6
            unsteady = max(found.seconds) / found.median
            cut = float((found.newest.area / found.newest.area_free).mean())
            held = found.bytes_each / 1000 if vehicles > 1 else float("nan")
            rows.append((method, "zonotope", vehicles, each, unsteady, held if vehicles > 1 else "", cut))
            if vehicles == 1:
                alone[method] = each
                claims.append(Claim(f"{method}, one vehicle alone, µs", each, "≤", 1500.0))
            if vehicles == 1000:
                claims.append(Claim(f"{method}, 1000 vehicles, µs a vehicle", each, "≤", WANTED[method]))
                claims.append(Claim(f"{method}, 1000 vehicles, longest update over median", unsteady, "≤", 2.0))
                claims.append(Claim(f"{method}, 1000 vehicles, kB a vehicle", held, "≤", 300.0))
    vehicles = sizes[-2]
    constrained = replace(drives, profile=drives.profile.model_copy(update={"cuts": "constrained"}))
    found = measure(constrained, vehicles, "set_membership", updates=5)
    cut = float((found.newest.area / found.newest.area_free).mean())
    rows.append(("set_membership", "constrained", vehicles, found.median / vehicles * 1e6,
                 max(found.seconds) / found.median, found.bytes_each / 1000, cut))  # fmt: skip
    for name, matrix_zonotope in (("as published", True), ("as published, no matrix zonotope", False)):
        each = _published(drives, matrix_zonotope, 2 if quick else 5) * 1e6
        rows.append((name, "zonotope", 1, each, "", "", ""))
        claims.append(Claim(f"{name}: its time over that of paper, one vehicle", each / alone["paper"], "≥", 1.0))
    return Table(
        "One update",
        f"A sample in, a tube of {HORIZON} steps out with its outlines, areas, boxes, verdicts and audit; window of "
        f"{window}, 4 states, 2 inputs, {fleets.LAGS} lags, {PREDICATES} predicates at every step, a known plan. "
        "'Longest' is the longest update over the median one, refits included; 'area' that with side information "
        "over that without. 'As published' is one vehicle's update with a pseudoinverse at every step, from its data "
        "matrices on: no message, window, outline or audit.",
        ("method", "cuts", "vehicles", "µs a vehicle", "longest", "kB a vehicle", "area"),
        rows,
        claims,
    )


def _published(drives: Drives, matrix_zonotope: bool, repeats: int) -> float:
    """Seconds of one update of the published form."""
    window = drives.profile.window
    x, u = drives.measured[0], drives.inputs[0]
    lagged = np.concatenate([np.roll(u, lag, axis=0) for lag in range(fleets.LAGS + 1)], axis=1)[fleets.LAGS : window]
    process, measurement = drives.profile.noise.process, drives.profile.noise.measurement
    assert process is not None
    assert measurement is not None
    plan = np.repeat(lagged[-1:], HORIZON, axis=0)
    strips = [(np.eye(4)[1], 0.0, 0.15), (np.eye(4)[3], 1.0, 0.06)]
    data = x[fleets.LAGS : window].T, lagged.T, x[fleets.LAGS + 1 : window + 1].T
    start, noise = (x[window - 1], measurement.matrix()), (np.zeros(4), process.matrix())

    def update() -> object:
        return published.tube(*data, start, plan, noise, np.zeros(4), strips, 40, matrix_zonotope=matrix_zonotope)

    return median_seconds(update, repeats)
