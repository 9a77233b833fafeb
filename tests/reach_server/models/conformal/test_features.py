"""Features, targets and regressors of size against their definitions."""

import numpy as np
import pytest

from fleet_bus.messages import VehicleProfile, parse_profile
from reach_server.data.regressors import RegressorSpec
from reach_server.data.window import Window
from reach_server.models.conformal import features
from reach_server.models.conformal.spec import FeatureSpec
from tests.reach_server.models.conformal.streams import (
    CAR,
    PLAIN,
    batch_of,
    drive,
    slow_features,
    slow_increment,
    slow_sizes,
)

WORLD = CAR.model_copy(update={"frame": "world"})
SPEEDLESS = parse_profile(
    {**CAR.model_dump(by_alias=True, exclude_none=True), "roles": {"position": ["x", "y"], "heading": "yaw"}}
)
PROFILES = {"car": CAR, "world": WORLD, "no speed": SPEEDLESS, "plain": PLAIN}


@pytest.mark.parametrize("planned", [False, True])
@pytest.mark.parametrize("name", list(PROFILES))
def test_columns_are_what_their_definition_says(name: str, planned: bool) -> None:
    profile = PROFILES[name]
    spec = FeatureSpec.of(profile, RegressorSpec.of(profile), profile.horizon, planned=planned)
    window = Window(profile, 40)
    window.grow(1)
    rng = np.random.default_rng(0)
    x, u = drive(100, 1)
    x, u = x[:, : spec.n], u[:, : spec.m]
    jitter = rng.uniform(-0.1, 0.1, 100)
    batch = batch_of(x, u, profile, jitter=jitter)
    window.append(batch)
    ring = window.arrays()
    t, states, inputs = ring.t[0], ring.x[0], ring.u[0]
    phi, y = np.empty(spec.total), np.empty(spec.horizon * spec.n)
    psi = np.empty(spec.sizes)
    for number in range(70, 100 - spec.horizon):
        features.recorded(t, states, inputs, number, spec, phi)
        np.testing.assert_allclose(phi, slow_features(batch.t, x, u, number, spec), rtol=1e-9, atol=1e-12)
        features.targets(t, states, number, spec, y)
        slow = [slow_increment(batch.t, x, number + h, spec) for h in range(spec.horizon)]
        np.testing.assert_allclose(y, np.concatenate(slow), rtol=1e-9, atol=1e-12)
        for h in range(spec.horizon):
            features.size_regressors(phi, h, spec, psi)
            np.testing.assert_allclose(psi, slow_sizes(batch.t, x, u, number, h, spec), rtol=1e-7, atol=1e-12)
        plan = u[number + 1 : number + spec.horizon].copy()
        planned_phi = np.empty(spec.total)
        features.present(t, states, inputs, number, spec, planned_phi)
        if planned:
            features.ahead(states, number, plan, spec, planned_phi)
        np.testing.assert_array_equal(planned_phi, phi)


def test_a_sample_is_a_datum_where_all_is_there() -> None:
    spec = FeatureSpec.of(CAR, RegressorSpec.of(CAR), CAR.horizon, planned=True)
    window = Window(CAR, 60)
    window.grow(1)
    x, u = drive(60, 2)
    u[20] = np.nan
    window.append(batch_of(x[:40], u[:40], CAR))
    window.append(batch_of(x[40:], u[40:], CAR, first=41))
    window.gate(np.array([0]), np.array([50]))
    ring = window.arrays()
    run, known, gated = ring.run[0], ring.input_known[0], ring.gated[0]
    linked = np.r_[False, np.ones(39, bool), False, np.ones(19, bool)]
    for number in range(spec.reach, 60 - spec.horizon):
        back = range(number - spec.reach, number)
        complete = all(linked[k + 1] for k in back) and not number - spec.lags <= 20 <= number
        assert features.complete(run, known, number, spec) == complete
        usable = complete and all(linked[number + h] for h in range(1, spec.horizon + 1))
        usable = usable and not number < 20 < number + spec.horizon
        usable = usable and not number - spec.increments <= 50 <= number + spec.horizon
        assert features.usable(run, known, gated, number, spec) == usable


def test_lagged_increments_follow_the_lags_of_inputs() -> None:
    def increments(profile: VehicleProfile) -> int:
        return FeatureSpec.of(profile, RegressorSpec.of(profile), 3, planned=False).increments

    assert [increments(CAR.model_copy(update={"input_lags": lags})) for lags in (0, 4, 8, 25)] == [2, 2, 4, 6]
