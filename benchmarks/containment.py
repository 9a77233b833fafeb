"""Do the guaranteed sets hold every state that a vehicle can reach? Known systems, all methods, every step."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from benchmarks.report import Cell, Claim, Table
from fleet_bus.messages import Label, VehicleProfile
from fleet_lab.systems import DT, System, continuations, drive, systems
from reach_server.data.window import SampleBatch
from reach_server.engine.engine import Engine, PlannedInputs
from reach_server.engine.results import Tubes
from reach_server.numeric.jit import kernel
from reach_server.numeric.types import FloatArray
from reach_server.sets.kernels import membership

START = 10**18
#: Samples between two tubes of a vehicle, so that models are refitted and windows move on in between.
STRIDE = 3
#: A factor may exceed its bound by this much, and the point be missed by this much of the size of the set: rounding.
SLACK = 1e-9
#: Passes over all factors after which a linear program decides.
SWEEPS = 200


@dataclass(frozen=True)
class Size:
    """How much is looked at: tubes of ``vehicles`` at ``ticks`` moments each, ``samples`` states a tube and step."""

    vehicles: int
    ticks: int
    samples: int


FULL = Size(40, 25, 400)
QUICK = Size(5, 4, 25)


@dataclass(frozen=True, eq=False)
class Evidence:
    """What was seen of one system by one method: tubes, states looked at and states outside by step (N,).

    ``area`` (tubes, N) of the published sets; ``ratio`` (tubes, N): mean width of a set in the plane over that of the
    convex hull of the states. ``reach`` (N,): the greatest share of a half-width at which a state lay; 1 is the border.
    ``waiting``: vehicles that got no tube; ``unsure``: tubes that are not labelled guaranteed.
    """

    tubes: int
    states: NDArray[np.int64]
    outside: NDArray[np.int64]
    area: FloatArray
    ratio: FloatArray
    reach: FloatArray
    waiting: int
    unsure: int


def evidence(system: System, methods: tuple[str, ...], size: Size, seed: int = 0) -> dict[str, Evidence]:
    """The tubes of a system by some methods, held against the same states; all through ``Engine``."""
    rng = np.random.default_rng([seed, *system.name.encode()])
    engines = {method: Engine(system.profile, method=method) for method in methods}
    horizon = system.profile.horizon
    begin = system.profile.window + system.profile.input_lags + 2
    drives = drive(system, size.vehicles, begin + STRIDE * size.ticks + horizon + 1, rng)
    tallies = {method: _Tally(size, horizon) for method in methods}
    for engine in engines.values():
        for vehicle in range(size.vehicles):
            engine.add(f"v{vehicle}")
        engine.append(_samples(system, drives.measured, drives.inputs, 0, begin))
    for tick in range(size.ticks):
        k = begin + STRIDE * (tick + 1) - 1
        states = continuations(system, drives, k, size.samples, horizon, rng)
        around = _perimeters(states[..., list(system.profile.position)])
        for method, engine in engines.items():
            batch = _samples(system, drives.measured, drives.inputs, k - STRIDE + 1, k + 1)
            tubes = engine.step(batch, _known(system, drives.inputs[k + 1 : k + horizon]))
            tallies[method].add(tubes, states, around, system.profile)
    return {method: tally.result() for method, tally in tallies.items()}


class _Tally:
    """Counts what lies in the tubes of one method."""

    def __init__(self, size: Size, horizon: int) -> None:
        self._vehicles = size.vehicles
        self._counts = np.zeros((2, horizon), dtype=np.int64)
        self._reach = np.zeros(horizon)
        self._areas, self._ratios = [np.zeros((0, horizon))], [np.zeros((0, horizon))]
        self._waiting = self._unsure = 0

    def add(self, tubes: Tubes, states: FloatArray, perimeters: FloatArray, profile: VehicleProfile) -> None:
        """Hold states (V, K, N, n) against the tubes of a tick; ``perimeters`` (V, N) are those of their hulls."""
        rows = np.array([int(name[1:]) for name in tubes.vehicles], dtype=np.intp)
        self._waiting += self._vehicles - len(rows)
        around = np.zeros((len(rows), len(self._reach)))
        for h, sets in enumerate(tubes.steps):
            points = states[rows, :, h]
            turned = points[..., profile.angles] - sets.center[:, None, profile.angles]
            points[..., profile.angles] -= 2 * np.pi * np.round(turned / (2 * np.pi))
            held = held_by(sets.center, sets.generators, points)
            self._counts[0, h] += held.size
            self._counts[1, h] += np.count_nonzero(~held)
            half = np.maximum(np.abs(sets.generators).sum(axis=-1), 1e-300)
            share = np.abs(points - sets.center[:, None]) / half[:, None]
            self._reach[h] = max(self._reach[h], float(share.max(initial=0.0)))
            # Of a planar zonotope, exactly.
            around[:, h] = 4.0 * np.sqrt((sets.generators[:, list(profile.position)] ** 2).sum(axis=1)).sum(axis=-1)
        self._unsure += sum(label is not Label.GUARANTEED for label in tubes.labels)
        self._areas.append(tubes.area)
        self._ratios.append(around / perimeters[rows])

    def result(self) -> Evidence:
        """What was counted."""
        states, outside = self._counts
        area, ratio = np.concatenate(self._areas), np.concatenate(self._ratios)
        return Evidence(len(area), states, outside, area, ratio, self._reach, self._waiting, self._unsure)


def held_by(center: FloatArray, generators: FloatArray, points: FloatArray) -> NDArray[np.bool_]:
    """Which points (B, K, n) lie in the zonotopes <center (B, n), generators (B, n, g)>, up to rounding.

    Decided by a certificate each way: factors that reach the point, or a direction that separates it; by a linear
    program where neither is found.
    """
    size = np.abs(generators).sum(axis=-1)
    # A coordinate in which the set is a point is met up to the rounding of the subtraction.
    floor = membership.ULPS * (np.abs(points).max(axis=1) + np.abs(center)) / SLACK
    scale = np.maximum(np.maximum(size, floor), 1e-300)
    scaled = np.ascontiguousarray(generators / scale[..., None])
    wanted = np.ascontiguousarray((points - center[:, None]) / scale[:, None])
    values, vectors = np.linalg.eigh(scaled @ np.swapaxes(scaled, 1, 2))
    inverse = np.where(values > 1e-12, 1.0 / np.maximum(values, 1e-12), 0.0)
    least = np.swapaxes(scaled, 1, 2) @ (vectors * inverse[:, None]) @ np.swapaxes(vectors, 1, 2)
    verdict = _decide(scaled, np.ascontiguousarray(least), wanted)
    held = verdict == 1
    rows, columns = np.nonzero(verdict < 0)
    if len(rows):
        none = np.zeros((len(rows), 0, generators.shape[-1]))
        held[rows, columns] = membership.contains(
            center[rows], generators[rows], none, none[..., 0], points[rows, columns]
        )
    return np.asarray(held)


@kernel
def _decide(generators: FloatArray, least: FloatArray, wanted: FloatArray) -> NDArray[np.int8]:
    """1 inside, 0 outside, -1 undecided (B, K): points (B, K, n) of zonotopes (B, n, g) around zero whose half-widths
    are at most 1. ``least`` (B, g, n) gives factors of least norm; from them on, one factor after another is moved to
    where it brings the point nearest, and the rest that stays separates the point if it is outside."""
    batch, n, g = generators.shape
    count = wanted.shape[1]
    verdict = np.full((batch, count), -1, dtype=np.int8)
    factor, rest = np.zeros(g), np.zeros(n)
    square = np.zeros(g)
    for row in range(batch):
        for j in range(g):
            square[j] = 0.0
            for i in range(n):
                square[j] += generators[row, i, j] ** 2
        for k in range(count):
            for i in range(n):
                rest[i] = wanted[row, k, i]
            for j in range(g):
                value = 0.0
                for i in range(n):
                    value += least[row, j, i] * wanted[row, k, i]
                factor[j] = min(1.0, max(-1.0, value))
                for i in range(n):
                    rest[i] -= generators[row, i, j] * factor[j]
            for _ in range(SWEEPS):
                largest = 0.0
                for i in range(n):
                    largest = max(largest, abs(rest[i]))
                if largest <= SLACK:
                    verdict[row, k] = 1
                    break
                along, height = 0.0, 0.0
                for i in range(n):
                    along += rest[i] * wanted[row, k, i]
                for j in range(g):
                    value = 0.0
                    for i in range(n):
                        value += rest[i] * generators[row, i, j]
                    height += abs(value)
                if along > height * (1.0 + SLACK) + SLACK * largest:
                    verdict[row, k] = 0
                    break
                for j in range(g):
                    if square[j] > 0.0:
                        value = factor[j]
                        for i in range(n):
                            value += generators[row, i, j] * rest[i] / square[j]
                        value = min(1.0, max(-1.0, value))
                        for i in range(n):
                            rest[i] -= generators[row, i, j] * (value - factor[j])
                        factor[j] = value
    return verdict


def _perimeters(points: FloatArray) -> FloatArray:
    """Perimeters (V, N) of the convex hulls of points (V, K, N, 2); of a plane set π times its mean width."""
    # Joggled (QJ), since hulls may be flat; the area of a planar hull is its perimeter.
    return np.array([[ConvexHull(one, qhull_options="QJ").area for one in np.swapaxes(v, 0, 1)] for v in points])


def _samples(system: System, measured: FloatArray, inputs: FloatArray, first: int, last: int) -> SampleBatch:
    """Samples ``first`` to ``last - 1`` of all vehicles."""
    count, vehicles = last - first, measured.shape[1]
    k = np.repeat(np.arange(first, last), vehicles)
    return SampleBatch(
        np.tile(np.arange(vehicles, dtype=np.intp), count),
        np.ones(len(k), dtype=np.uint64),
        k.astype(np.uint64),
        START + k * round(DT * 1e9),
        np.zeros(len(k), dtype=np.uint32),
        measured[first:last].reshape(len(k), -1),
        inputs[first:last].reshape(len(k), -1),
    )


def _known(system: System, later: FloatArray) -> PlannedInputs | None:
    if system.plan_tolerance is None:
        return None
    plan = np.ascontiguousarray(np.swapaxes(later, 0, 1))
    return PlannedInputs(plan, np.broadcast_to(system.plan_tolerance, (len(plan), plan.shape[2])).copy())


def run(quick: bool) -> Table:
    """States outside of guaranteed sets, by system and method, and how tight the sets are."""
    size = QUICK if quick else FULL
    rows: list[tuple[Cell, ...]] = []
    totals: dict[str, NDArray[np.int64]] = {}
    outside = unsure = 0
    for system in systems():
        for method, seen in evidence(system, system.methods, size).items():
            totals[method] = totals.get(method, np.zeros_like(seen.states)) + seen.states
            outside += int(seen.outside.sum())
            unsure += seen.unsure + seen.waiting
            rows.append(
                (
                    system.name, method, seen.tubes, int(seen.states.sum()), int(seen.outside.sum()),
                    *(float(a[i]) for a in (seen.reach, *(np.median(b, axis=0) for b in (seen.ratio, seen.area)))
                      for i in (0, -1)),
                )
            )  # fmt: skip
    least = min(int(states.min()) for states in totals.values())
    return Table(
        "States outside of guaranteed sets",
        f"Simulated systems with known dynamics, noise sets and slopes; {size.vehicles} vehicles in one engine each, "
        f"tubes of {systems()[0].profile.horizon} steps at {size.ticks} moments. Each tube is held against "
        f"{size.samples} trajectories: the state now anywhere that its measurement allows, later inputs anywhere that "
        "plan or limits and rates allow, noise anywhere in its set, most of it at corners; the first is what really "
        "happened. 'Reach': the greatest share of a half-width at which a state lay (1: the border). 'Width': median "
        "of the mean width in the plane over that of the convex hull of the sampled states, which is less than what "
        "can be reached. At the first and at the last step.",
        (
            "system", "method", "tubes", "states", "outside", "reach, 1", "reach, 10", "width, 1", "width, 10",
            "area, 1", "area, 10",
        ),
        rows,
        [
            Claim("guaranteed sets: true states outside", float(outside), "≤", 0.0),
            Claim("true states held against every method at every step", float(least), "≥", 500.0 if quick else 1e6),
            Claim("tubes missing or not labelled guaranteed", float(unsure), "≤", 0.0),
        ],
        keys=2,
    )  # fmt: skip
