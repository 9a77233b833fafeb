"""No state that a known system can reach lies outside of a guaranteed set, whatever the method and the step.

`python -m benchmarks containment` holds four thousand times as many states against the same sets.
"""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.containment import QUICK, evidence, held_by
from fleet_lab.systems import DT, continuations, drive, members, systems
from reach_server.numeric.types import FloatArray
from reach_server.sets.kernels import membership

KNOWN = {system.name: system for system in systems()}


@pytest.mark.parametrize("name", KNOWN)
def test_no_reachable_state_lies_outside(name: str) -> None:
    system = KNOWN[name]
    found = evidence(system, system.methods, QUICK)
    for method, seen in found.items():
        assert seen.waiting == seen.unsure == 0, method
        assert (seen.states == QUICK.vehicles * QUICK.ticks * QUICK.samples).all(), method
        assert not seen.outside.any(), (method, seen.outside)
        # What is held against the sets reaches well into their outer half, so that smaller sets would be found out.
        assert seen.reach[0] > 0.25, method
    smaller, larger = (np.median(found[m].area, axis=0) for m in ("set_membership", "residual_hull"))
    assert (smaller <= larger * (1 + 1e-9)).all()


@pytest.mark.parametrize("fields", [{"nearest": 8, "reservoir": 40}, {"filtered": True}], ids=["budget", "filtered"])
@pytest.mark.parametrize("name", ["linear", "bicycle, body frame", "correlated noise", "stiff"])
def test_nor_with_few_data_old_data_or_states_that_were_filtered(name: str, fields: dict[str, object]) -> None:
    system = replace(KNOWN[name], profile=KNOWN[name].profile.model_copy(update=fields))
    for method, seen in evidence(system, ("set_membership", "residual_hull"), QUICK).items():
        assert seen.waiting == seen.unsure == 0, method
        assert not seen.outside.any(), (method, seen.outside)


@pytest.mark.parametrize("name", KNOWN)
def test_the_stated_slopes_and_noise_are_true(name: str) -> None:
    """Chords between random points are within the slopes: what the profiles claim, looked at from outside."""
    system = KNOWN[name]
    assert system.profile.lipschitz is not None
    lower, upper = np.array(system.profile.lipschitz.lower), np.array(system.profile.lipschitz.upper)
    rng = np.random.default_rng(0)
    low, high = system.limits
    lags = system.profile.input_lags
    n, count = system.n, 4000
    body = system.profile.frame == "body"
    x = rng.uniform(-1.7, 1.7, (2, count, n)) * (np.array([1.0, 1000.0]) if name == "stiff" else 1.0)
    if body:
        x[..., :3] = 0.0
    u = rng.uniform(low, high, (2, count, lags + 1, len(low)))
    # Half of the pairs differ in one regressor only, where slopes show at their worst.
    free = list(range(n))[3 if body else 0 :]
    xi = np.concatenate([x[..., free], u.reshape(2, count, -1)], axis=-1)
    one = rng.integers(0, xi.shape[-1], count // 2)
    alone = np.arange(xi.shape[-1]) == one[:, None]
    xi[1, : count // 2] = np.where(alone, xi[1, : count // 2], xi[0, : count // 2])
    x[..., free] = xi[..., : len(free)]
    u = xi[..., len(free) :].reshape(u.shape)
    after = system.step(x, u, np.zeros_like(x)) - (x if body else 0.0)
    step, change = xi[1] - xi[0], after[1] - after[0]
    least = np.minimum(lower * step[:, None], upper * step[:, None]).sum(axis=-1)
    most = np.maximum(lower * step[:, None], upper * step[:, None]).sum(axis=-1)
    slack = 1e-9 * (1 + np.abs(change))
    assert (least - slack <= change).all()
    assert (change <= most + slack).all()


@pytest.mark.parametrize("name", KNOWN)
def test_inputs_keep_the_limits_rates_and_plans_of_the_profile(name: str) -> None:
    system = KNOWN[name]
    commands: list[FloatArray] = []

    def spying(x: FloatArray, u: FloatArray, w: FloatArray) -> FloatArray:
        commands.append(u[..., 0, :])
        return system.step(x, u, w)

    spied = replace(system, step=spying)
    rng = np.random.default_rng(0)
    drives = drive(system, 3, 60, rng)
    states = continuations(spied, drives, 40, 30, 10, rng)
    np.testing.assert_array_equal(states[:, 0], np.swapaxes(drives.truth[41:51], 0, 1))
    found = np.stack(commands)
    low, high = system.limits
    assert ((found >= low) & (found <= high)).all()
    np.testing.assert_array_equal(found[0], np.repeat(drives.inputs[40][:, None], 30, axis=1))
    if system.plan_tolerance is not None:
        off = np.abs(found[1:] - drives.inputs[41:50][:, :, None])
        assert (off <= system.plan_tolerance + 1e-12).all()
        assert (off.max(axis=(0, 1, 2)) > 0.9 * system.plan_tolerance).all()
    elif system.profile.future_inputs == "rate":
        rates = np.array([spec.rate for spec in system.profile.inputs.values()])
        assert (np.abs(np.diff(found, axis=0)) <= rates * DT).all()


@pytest.mark.parametrize("n", [1, 2, 4])
def test_the_verdict_on_points_is_that_of_linear_programs(n: int) -> None:
    rng = np.random.default_rng(n)
    center, generators = rng.normal(size=(6, n)), rng.normal(size=(6, n, 9))
    generators[1, 0] = 0.0
    generators[2] = generators[2, :, :1] * generators[2, :1]
    points = center[:, None] + 2.5 * np.einsum("bng,bkg->bkn", generators, rng.uniform(-1, 1, (6, 60, 9)))
    points[:, :20] = center[:, None] + np.einsum("bng,bkg->bkn", generators, rng.choice([-1.0, 1.0], (6, 20, 9)))
    points[:, 20:24] += 1e-4 * rng.normal(size=(6, 4, n))
    none = np.zeros((6, 1, 0, 9))
    wanted = membership.contains(center[:, None], generators[:, None], none, none[..., 0], points)
    assert 0.2 < wanted.mean() < 0.99
    np.testing.assert_array_equal(held_by(center, generators, points), wanted)


def test_members_of_a_noise_set_reach_its_corners_and_no_farther() -> None:
    generators = np.array([[0.9, 0.1], [0.9, -0.2]])
    points = members(np.random.default_rng(0), generators, (500,))
    assert held_by(np.zeros((1, 2)), generators[None], points[None]).all()
    np.testing.assert_allclose(np.abs(points).max(axis=0), np.abs(generators).sum(axis=1))
