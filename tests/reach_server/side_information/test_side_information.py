"""Trajectories that satisfy a formula stay in the tubes that it cuts; those that do not are found out."""

import copy
import random
from functools import cache

import numpy as np
import pytest

from benchmarks.formulas import Atoms, random_tree, satisfied, text_of
from fleet_bus.messages import EventKind, VehicleProfile
from reach_server.data.window import SampleBatch
from reach_server.engine.engine import Engine
from reach_server.numeric.types import FloatArray
from side_info import Scenario
from tests.reach_server.drives import START, SVEA, World, inside, noise

WORLD = World()
DRIVES, NOW, SAMPLES = 160, 60, 130
HORIZON = 10
STEP_MS = round(SVEA.dt * 1000)
#: Samples after time zero that are streamed.
STREAMED = 40


@cache
def drives() -> tuple[FloatArray, FloatArray, FloatArray]:
    """True states and measured ones (D, S, 2), and inputs (D, S, 1), of drives under random inputs."""
    rng = np.random.default_rng(5)
    # As fast as the profile's rate allows, with pauses.
    steps = rng.choice([-0.5, -0.2, 0.0, 0.2, 0.5], (DRIVES, SAMPLES, 1))
    u = np.zeros((DRIVES, SAMPLES, 1))
    for k in range(1, SAMPLES):
        u[:, k] = np.clip(u[:, k - 1] + steps[:, k], -1.0, 1.0)
    x = np.zeros((DRIVES, SAMPLES, 2))
    for k in range(1, SAMPLES):
        lagged = u[:, k - 2] if k > 1 else np.zeros((DRIVES, 1))
        x[:, k] = WORLD.f(np.concatenate([x[:, k - 1], u[:, k - 1], lagged], axis=1))
        x[:, k] += noise(rng, WORLD.process, DRIVES)
    error = noise(rng, WORLD.measurement, DRIVES * SAMPLES).reshape(DRIVES, SAMPLES, 2)
    return x, x + error, u


def samples(which: "np.ndarray[tuple[int], np.dtype[np.intp]]", first: int, last: int) -> SampleBatch:
    """Samples ``first`` to ``last - 1`` of some drives, which are the vehicles of the same numbers."""
    _, y, u = drives()
    k = np.tile(np.arange(first, last), len(which))
    slot = np.repeat(which, last - first)
    return SampleBatch(
        slot, np.ones(len(k), np.uint64), k.astype(np.uint64) + np.uint64(1), START + k * SVEA.dt_ns,
        np.zeros(len(k), np.uint32), y[slot, k], u[slot, k],
    )  # fmt: skip


@cache
def filled(cuts: str) -> Engine:
    profile = VehicleProfile.model_validate(
        {**WORLD.profile.model_dump(by_alias=True), "cuts": cuts, "window": 50, "horizon": HORIZON}
    )
    engine = Engine(profile)
    for d in range(DRIVES):
        engine.add(f"car-{d}")
    engine.append(samples(np.arange(DRIVES), 0, NOW))
    return engine


def scenario(formula: str, name: str = "random") -> Scenario:
    return Scenario.parse(
        f"scenario: {name}\nversion: 1\nstate: {{x1: m, x2: m}}\ntime: {{zero: on_start, semantics: sampled}}\n"
        f"assume: '{formula}'\n"
    )


def stream(engine: Engine, which: "np.ndarray[tuple[int], np.dtype[np.intp]]") -> tuple[int, int, int, float]:
    """(steps checked, true states outside, events, mean ratio of areas with and without side information)."""
    x, _, _ = drives()
    rng = np.random.default_rng(0)
    checked = outside = events = 0
    ratios = []
    for k in range(NOW, NOW + STREAMED):
        tubes = engine.step(samples(which, k, k + 1))
        events += sum(event.kind is EventKind.CONTRADICTION for event in tubes.events)
        ratios.append((tubes.area / tubes.area_free).mean())
        for h, sets in enumerate(tubes.steps):
            points = x[which, k + 1 + h]
            for row in range(len(which)):
                outside += not inside(sets, row, points[row : row + 1], rng, 12)[0]
            box = sets.center + np.stack([-1.0, 1.0])[:, None, None] * np.abs(sets.generators).sum(axis=2)
            outside += int(((points < box[0] - 1e-9) | (points > box[1] + 1e-9)).any(axis=1).sum())
            low, high = tubes.hull[:, h, 0] + sets.center, tubes.hull[:, h, 1] + sets.center
            outside += int(((points < low) | (points > high)).any(axis=1).sum())
            checked += len(which)
    return checked, outside, events, float(np.mean(ratios))


@pytest.mark.parametrize("seed", range(14))
@pytest.mark.slow
def test_satisfying_trajectories_never_leave_the_tube(seed: int) -> None:
    """Formulas nested to depth 3; measured with noise, true states checked at every step of every horizon."""
    rng = random.Random(seed)
    x, _, _ = drives()
    atoms = Atoms(rng, x[:, NOW:].reshape(-1, 2))
    which = np.zeros(0, dtype=np.intp)
    while not 8 <= len(which) <= 0.5 * DRIVES:
        tree = random_tree(rng, 3, atoms)
        if tree[0] == "atom":
            continue
        which = np.flatnonzero(satisfied(tree, x, NOW, atoms))
    which = which[:24]
    engine = copy.deepcopy(filled(["zonotope", "constrained", "frobenius"][seed % 3]))
    side = scenario(text_of(tree, atoms, STEP_MS))
    for d in which:
        engine.assign(f"car-{d}", side, START + NOW * SVEA.dt_ns)
    checked, outside, events, ratio = stream(engine, which)
    print(f"{checked} steps, {outside} outside, area {ratio:.3f} of that without side information: {side.assume}")
    assert checked == len(which) * STREAMED * HORIZON
    assert (outside, events) == (0, 0)
