"""One engine step per vehicle: how the cost falls as vehicles share a batch."""

from itertools import count

import numpy as np

from benchmarks.report import Cell, Table
from benchmarks.timing import median_seconds
from reach_server.engine import Engine, KnownInputs
from reach_server.windows import Floats, SampleBatch
from vehicle_agent.simulate import Drive, simulate_history
from vehicle_agent.svea import SveaParameters, profile

FIRST, STEPS = 1050, 20


def run(quick: bool) -> Table:
    """Microseconds a vehicle and update, by method and number of vehicles."""
    drive = simulate_history(1, FIRST + STEPS + 40, SveaParameters())
    rows: list[tuple[Cell, ...]] = [
        (method, vehicles, _seconds(method, vehicles, drive) / vehicles * 1e6)
        for method in ("set_membership", "residual_hull", "calibrated")
        for vehicles in ((1, 10) if quick else (1, 10, 100))
    ]
    return Table(
        "The engine",
        "One update: a sample in, a tube of 10 steps out, window of 1000 samples.",
        ("method", "vehicles", "µs a vehicle and update"),
        rows,
    )


def _seconds(method: str, vehicles: int, drive: Drive) -> float:
    parameters = SveaParameters()
    engine = Engine(profile(parameters), method=method)
    for i in range(vehicles):
        engine.add(f"v{i}")

    def everyone(row: Floats) -> Floats:
        return np.repeat(row[None], vehicles, axis=0)

    def batch(k: int) -> SampleBatch:
        return SampleBatch(
            np.arange(vehicles), np.ones(vehicles, dtype=np.uint64), np.full(vehicles, k, dtype=np.uint64),
            np.full(vehicles, 10**18 + k * parameters.dt_ns), np.zeros(vehicles, dtype=np.uint32),
            everyone(drive.measured[k]), everyone(drive.inputs[k]),
        )  # fmt: skip

    for k in range(FIRST):
        engine.append(batch(k))
    moments = count(FIRST)

    def update() -> None:
        k = next(moments)
        engine.step(batch(k), KnownInputs(everyone(drive.inputs[k + 1 : k + engine.horizon]), np.zeros((vehicles, 2))))

    return median_seconds(update, STEPS)
