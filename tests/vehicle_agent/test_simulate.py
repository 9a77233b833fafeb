"""Simulated drives: they obey, they are lively, and they follow the true dynamics."""

import itertools

import numpy as np
import pytest
from numpy.typing import NDArray

from fleet_bus.errors import UsageError
from vehicle_agent.angles import wrap
from vehicle_agent.route import load_route, route_names
from vehicle_agent.simulate import Drive, simulate_drive, simulate_history, stand_still
from vehicle_agent.svea import SveaParameters, increment

P = SveaParameters()
RATES = np.array([P.steering_rate, P.velocity_rate]) * P.dt
LIMITS = np.array([P.steering_limit, P.velocity_limit])


def process_noise(drive: Drive) -> NDArray[np.float64]:
    """Noise (K-1, 4) in the body frame that explains the true states, given the commands."""
    now, after = drive.truth[:-1], drive.truth[1:]
    moved = after - now
    moved[:, 2] = wrap(moved[:, 2])
    cos, sin = np.cos(now[:, 2]), np.sin(now[:, 2])
    body = np.column_stack(
        (cos * moved[:, 0] + sin * moved[:, 1], -sin * moved[:, 0] + cos * moved[:, 1], moved[:, 2:])
    )
    delayed = np.append(np.zeros(P.steering_delay), drive.inputs[:, 0])[: len(now)]
    return body - increment(P, now[:, 3], delayed, drive.inputs[:-1, 1])


def times(drive: Drive) -> NDArray[np.float64]:
    return np.arange(len(drive.truth), dtype=np.float64) * P.dt


def check_physics(drive: Drive) -> None:
    noise, bound = process_noise(drive), np.array(P.process_noise)
    assert (np.abs(noise) <= bound + 1e-12).all()
    assert (noise.max(axis=0) > 0.9 * bound).all()
    assert (noise.min(axis=0) < -0.9 * bound).all()
    error = drive.measured - drive.truth
    error[:, 2] = wrap(error[:, 2])
    assert (np.abs(error) <= np.array(P.sensor_noise) + 1e-12).all()
    assert (np.abs(drive.inputs) <= LIMITS).all()
    assert (np.abs(np.diff(drive.inputs, axis=0, prepend=np.zeros((1, 2)))) <= RATES).all()
    assert (np.abs(drive.truth[:, 2]) <= np.pi).all()
    assert (np.abs(drive.measured[:, 2]) <= np.pi).all()


@pytest.mark.parametrize("name", route_names())
def test_drives_obey_their_route_and_the_dynamics(name: str) -> None:
    route = load_route(name)
    starts = []
    for seed in range(6):
        drive = simulate_drive(route, seed)
        t = times(drive)
        assert t[-1] == pytest.approx(route.duration)
        assert route.obeyed(t, drive.truth[:, :2])
        check_physics(drive)
        speeds = drive.truth[40:, 3]
        assert speeds.min() > 0.25
        assert speeds.max() < 1.3
        starts.append(drive.truth[0, :2])
    assert all(np.hypot(*(a - b)) > 0.01 for a, b in itertools.combinations(starts, 2))


def test_parking_lot_formula_holds_as_the_paper_states_it() -> None:
    """Slow twin of the zones: phi_p, and the paper's own encoding of it."""
    for seed in range(4):
        x, y = simulate_drive(load_route("parking-lot"), seed).truth[:, :2].T
        k25, k24 = round(25 / P.dt), round(24 / P.dt)
        for k in range(k25 + 1):
            assert -1.437 <= x[k] <= 1.998
            assert -1.590 <= y[k] <= 3.268
        for k in range(k24, k25 + 1):
            assert abs(x[k] + 0.3225) <= 1.3045
            assert abs(y[k] + 1.137) <= 0.453
        for k in range(k25, len(x)):
            assert abs(y[k] + 1.665) <= 1


def test_roundabout_formula_holds_as_the_paper_states_it() -> None:
    for seed in range(4):
        x, y = simulate_drive(load_route("roundabout"), seed).truth[:, :2].T
        for k in range(len(x)):
            t = k / 20
            assert t > 4 or abs(y[k] - 2.25) <= 1
            assert not 4 <= t <= 10 or np.hypot(x[k] - 0.307, y[k] - 0.044) <= 1.429
            assert t < 10 or abs(y[k] + 2.169) <= 1


def test_drives_pass_near_the_borders() -> None:
    route = load_route("parking-lot")
    nearest = []
    for seed in range(6):
        drive = simulate_drive(route, seed)
        nearest.append(route.clearance(times(drive), drive.truth[:, :2]).min())
    assert min(nearest) < 0.1


def test_drives_repeat_by_seed() -> None:
    route = load_route("roundabout")
    first, again, other = (simulate_drive(route, seed) for seed in (3, 3, 4))
    np.testing.assert_array_equal(first.measured, again.measured)
    assert (first.measured != other.measured).any()


def test_a_route_that_nobody_can_drive_ends_in_an_error() -> None:
    route = load_route("roundabout")
    blocked = route.model_copy(update={"margin": 0.5})
    with pytest.raises(UsageError, match=r"none of 2 drives of seed 1 stays 0\.5 m inside its zones"):
        simulate_drive(blocked, 1, tries=2)


def test_history_excites_everything_and_ends_at_rest() -> None:
    drive = simulate_history(1, 1024)
    check_physics(drive)
    steering, velocity = drive.inputs[:-40].T
    v = drive.truth[:-40, 3]
    assert steering.min() < -0.6
    assert steering.max() > 0.6
    assert v.min() < -0.15
    assert v.max() > 1.4
    assert abs(np.corrcoef(steering, velocity)[0, 1]) < 0.3
    # Every speed with every steering angle: no empty cell in a 4 × 4 grid.
    cells, _, _ = np.histogram2d(steering, velocity, bins=4, range=[(-0.7, 0.7), (-0.4, 1.65)])
    assert (cells > 5).all()
    np.testing.assert_array_equal(drive.inputs[-10:], 0.0)
    assert abs(drive.truth[-1, 3]) < 0.1
    np.testing.assert_array_equal(simulate_history(1, 1024).measured, drive.measured)


def test_history_lengths() -> None:
    assert simulate_history(1, 0).truth.shape == (0, 4)
    shortest = simulate_history(1, 64)
    np.testing.assert_array_equal(shortest.inputs[-1], 0.0)
    with pytest.raises(UsageError, match="give 0 or at least 64"):
        simulate_history(1, 10)


def test_after_the_drive_the_car_stops_and_stands() -> None:
    drive = simulate_drive(load_route("roundabout"), 2)
    after = list(itertools.islice(stand_still(drive, 2), 100))
    whole = Drive(
        np.vstack([drive.truth, *[truth for truth, _, _ in after]]),
        np.vstack([drive.measured, *[measured for _, measured, _ in after]]),
        np.vstack([drive.inputs, *[u for _, _, u in after]]),
    )
    check_physics(whole)
    np.testing.assert_array_equal(whole.inputs[-50:], 0.0)
    assert np.abs(whole.truth[-50:, 3]).max() < 0.1
