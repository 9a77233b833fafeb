"""Sampled drives through two shipped scenarios, and which of the predicates hold at each sample."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from reach_server.numeric.types import FloatArray
from reach_server.predicates import Context, Literals
from side_info import Scenario
from side_info.stl.nnf import reach_ns
from vehicle_agent.route import load_route
from vehicle_agent.simulate import simulate_drive
from vehicle_agent.svea import SveaParameters

#: Simulated drives, of which each vehicle has one, begun so many seconds too late (negative) to too early.
DRIVES, SHIFT = 6, (-26.0, 8.0)


@dataclass(frozen=True, slots=True, eq=False)
class Traces:
    """``true`` (V, K, P): whether predicate p of the scenario holds at sample k of vehicle v, ``step_ns`` apart."""

    scenario: Scenario
    step_ns: int
    true: NDArray[np.bool_]


def parking_lot(vehicles: int, step_ns: int) -> Traces:
    """Cars that leave the lot at about the right time: some a little early, some late."""
    scenario = Scenario.load("parking-lot")
    route, parameters = load_route("parking-lot"), SveaParameters()
    every = step_ns // parameters.dt_ns
    drives = np.stack([simulate_drive(route, seed, parameters).truth[::every, :2] for seed in range(DRIVES)])
    rng = np.random.default_rng(2)
    shift = np.round(rng.uniform(*SHIFT, (vehicles, 1)) * 1e9 / step_ns).astype(np.intp)
    shift[::3] = 0
    last = drives.shape[1] - 1
    k = np.clip(np.arange(last + 1) + shift, 0, last)
    states = drives[np.arange(vehicles)[:, None] % DRIVES, k]
    return Traces(scenario, step_ns, _holding(scenario, states, {"x1": 0, "x2": 1}))


def convoy(vehicles: int, step_ns: int) -> Traces:
    """Cars on the ring road, most of them at the pace of the convoy, some too slow for its gates or not always on."""
    scenario = Scenario.load("convoy")
    reach = max(scenario.end_ns, *(reach_ns(r.holds) for r in scenario.requirements.values()))
    count = reach // step_ns + 1
    rng = np.random.default_rng(3)
    dt = step_ns / 1e9
    t = np.arange(count) * dt
    wave = np.sin(rng.uniform(0.2, 0.6, (vehicles, 1)) * t + rng.uniform(0, 2 * np.pi, (vehicles, 1)))
    speed = rng.uniform(0.62, 1.0, (vehicles, 1)) + 0.15 * wave
    # It joins slowly, up to its first gate.
    begin = rng.uniform(-1.2, -0.3, (vehicles, 1))
    speed = np.where(t < 7.0, np.minimum(speed, rng.uniform(0.5, 0.61, (vehicles, 1))), speed)
    radius = 2.0 + rng.uniform(0.0, 0.32, (vehicles, 1)) * np.sin(0.3 * t + rng.uniform(0, 6, (vehicles, 1)))
    angle = begin + np.cumsum(speed * dt / 2.0, axis=1)
    yaw = angle + np.pi / 2 + rng.uniform(-0.1, 0.1, (vehicles, count))
    states = np.stack([radius * np.cos(angle), radius * np.sin(angle), yaw, speed], axis=-1)
    return Traces(scenario, step_ns, _holding(scenario, states, {"x1": 0, "x2": 1, "yaw": 2, "v": 3}))


def _holding(scenario: Scenario, states: FloatArray, index: dict[str, int]) -> NDArray[np.bool_]:
    """(V, K, P) of exact states (V, K, n)."""
    vehicles, count, n = states.shape
    points = states.reshape(-1, n)
    nothing = np.zeros(len(points))
    context = Context(nothing, nothing, nothing, points, points)
    literals = Literals(n, (0, 1), np.zeros((n, 0)))
    numbers = [literals.add(p, index, scenario=scenario.name, name=p.name) for p in scenario.predicates]
    status = literals.verdict(numbers, points, np.zeros((len(points), n, 0)), context)
    return np.asarray(status >= 0).reshape(vehicles, count, -1)
