"""The engine over the study's drives: its bounds are true of the simulated car, and no state is outside."""

from dataclasses import replace

import numpy as np
import pytest

from fleet_lab.paper import runtime
from fleet_lab.paper.drives import CAR, SAMPLE_TIME, Track, displacement_error
from fleet_lab.paper.formulas import FORMULAS, PHI_P, PHI_R, Formula
from fleet_lab.paper.study import Study
from reach_server.numeric.types import FloatArray
from vehicle_agent import svea

SPEED = 1.7


def cut_off(track: Track, begin: int, samples: int) -> Track:
    """A part of a track, its time from zero on."""
    rows = slice(begin, begin + samples)
    return Track(
        track.name, track.t[rows] - track.t[begin], track.position[rows], track.heading[rows], track.velocity[rows]
    )


def cars(count: int) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """States (count, 4), steering, speed commands and noise of a car at its limits, and extreme ones among them."""
    rng = np.random.default_rng(0)
    state = np.column_stack([rng.uniform(-5, 5, (count, 2)), rng.uniform(-9, 9, count), rng.uniform(-1, 1, count)])
    steering, command, noise = rng.uniform(-1, 1, (3, count))
    extreme = rng.random((count, 4)) < 0.5
    signed = [np.where(extreme[:, i], np.sign(a), a) for i, a in enumerate((state[:, 3], steering, command, noise))]
    state[:, 3] = SPEED * signed[0]
    disturbed = np.column_stack([np.zeros((count, 2)), CAR.process_noise[2] * signed[3], np.zeros(count)])
    return state, CAR.steering_limit * signed[1], SPEED * signed[2], disturbed


def test_the_car_goes_no_farther_from_its_velocity_than_the_bound_says() -> None:
    state, steering, command, noise = cars(100_000)
    after = svea.step(CAR, state, steering, command, noise)
    velocity = state[:, 3:] * np.column_stack([np.cos(state[:, 2]), np.sin(state[:, 2])])
    off = np.hypot(*(after[:, :2] - state[:, :2] - SAMPLE_TIME * velocity).T)
    assert off.max() <= displacement_error(SPEED)
    # Not wider than it need be: the two ways to be off do not quite add up.
    assert off.max() > 0.6 * displacement_error(SPEED)
    slower = np.abs(state[:, 3]) <= 0.5
    slow_too = slower & (np.abs(command) <= 0.5)
    assert slow_too.sum() > 1000
    assert off[slow_too].max() <= displacement_error(0.5) < 0.5 * displacement_error(SPEED)


def test_the_profile_bounds_every_step_of_the_car() -> None:
    profile = runtime.profile("zonotope")
    state, steering, command, noise = cars(100_000)
    after = svea.step(CAR, state, steering, command, noise)
    velocity = state[:, 3:] * np.column_stack([np.cos(state[:, 2]), np.sin(state[:, 2])])
    regressors = np.column_stack([state[:, :3], velocity])
    assert profile.lipschitz is not None
    slopes = np.array(profile.lipschitz.lower)
    np.testing.assert_array_equal(slopes, profile.lipschitz.upper)
    left = np.abs(after[:, :3] - regressors @ slopes.T).max(axis=0)
    assert profile.noise.process is not None
    bound = np.abs(profile.noise.process.matrix()).sum(axis=1)
    assert (left <= bound + 1e-12).all()
    assert (left > 0.6 * bound).all()
    assert left[2] > 0.999 * bound[2]


def test_the_profile_bounds_the_drives_of_the_study(study: Study) -> None:
    moved = displacement_error(SPEED)
    for track in (*study.before, *study.lot, *study.ring):
        off = track.position[1:] - track.position[:-1] - SAMPLE_TIME * track.velocity[:-1]
        assert np.abs(off).max() <= moved
        assert np.abs(track.velocity).max() <= SPEED


@pytest.mark.parametrize("formula", FORMULAS, ids=lambda formula: formula.key)
def test_no_state_is_outside_of_what_the_engine_says(study: Study, formula: Formula) -> None:
    tracks = [cut_off(track, 0, 121) for track in study.tracks(formula)[:2]]
    told: list[tuple[int, int]] = []
    for cuts in ("zonotope", "constrained", "frobenius"):
        found = runtime.drive(formula, tracks, study.before, 0, cuts, lambda done, steps: told.append((done, steps)))
        assert found.area.shape == found.area_free.shape == found.inside.shape == found.inside_free.shape == (2, 12)
        assert found.seconds.shape == (12,)
        assert found.inside.all()
        assert found.inside_free.all()
        assert found.labels == ("guaranteed",)
        # Square centimetres at most, where the tables have square metres.
        assert (found.area_free < 1e-4).all()
        if cuts != "frobenius":
            assert (found.area <= found.area_free * (1 + 1e-9)).all()
    assert told[:2] == [(2, 120), (12, 120)]
    assert told[-1] == (112, 120)


@pytest.mark.parametrize("cuts", ["zonotope", "constrained"])
def test_side_information_cuts_where_its_border_is_near(study: Study, cuts: str) -> None:
    """A car in a region whose four sides it touches: the rows of several strips go through the recursion."""
    track = cut_off(study.lot[0], 0, 121)
    low, high = track.position.min(axis=0), track.position.max(axis=0)
    strips = [
        replace(strip, middle=float(middle), radius=float(half) + 1e-9)
        for strip, middle, half in zip(PHI_P.strips[:2], (low + high) / 2, (high - low) / 2, strict=True)
    ]
    found = runtime.drive(
        replace(PHI_P, strips=tuple(strips)), [track], study.before, 0, cuts, lambda done, steps: None
    )
    assert found.labels == ("guaranteed",)
    assert found.inside.all()
    assert found.area.min() < 0.8 * found.area_free.min()
    assert (found.area <= found.area_free * (1 + 1e-9)).all()


def test_bounds_that_are_too_small_are_noticed(study: Study, monkeypatch: pytest.MonkeyPatch) -> None:
    """Were the process noise a hundredth of what it is, states would be outside, or the engine would say so."""
    monkeypatch.setattr(runtime, "displacement_error", lambda speed: displacement_error(speed) / 100)
    monkeypatch.setattr(runtime, "MEASURED", (1e-5, 1e-5, 1e-5))
    track = cut_off(study.ring[0], 0, 121)
    found = runtime.drive(PHI_R, [track], study.before, 0, "zonotope", lambda done, steps: None)
    assert found.labels != ("guaranteed",) or not found.inside.all()


def test_the_same_seed_gives_the_same_sets(study: Study) -> None:
    track = cut_off(study.ring[1], 0, 61)
    areas = [
        runtime.drive(PHI_R, [track], study.before, seed, "zonotope", lambda done, steps: None).area
        for seed in (4, 4, 5)
    ]
    np.testing.assert_array_equal(areas[0], areas[1])
    assert not np.array_equal(areas[0], areas[2])
