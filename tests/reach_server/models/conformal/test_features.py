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
    rings,
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
    terms = FeatureSpec.of(profile, RegressorSpec.of(profile), profile.horizon, planned=planned)
    window = Window(profile, 40)
    window.grow(1)
    rng = np.random.default_rng(0)
    x, u = drive(100, 1)
    x, u = x[:, : terms.n], u[:, : terms.m]
    jitter = rng.uniform(-0.1, 0.1, 100)
    batch = batch_of(x, u, profile, jitter=jitter)
    window.append(batch)
    ring = rings(window)
    t, states, inputs = ring.t[0], ring.x[0], ring.u[0]
    phi, y = np.empty(terms.total), np.empty(terms.horizon * terms.n)
    psi = np.empty(terms.sizes)
    for number in range(70, 100 - terms.horizon):
        features.recorded(t, states, inputs, number, terms, phi)
        np.testing.assert_allclose(phi, slow_features(batch.t, x, u, number, terms), rtol=1e-9, atol=1e-12)
        features.targets(t, states, number, terms, y)
        slow = [slow_increment(batch.t, x, number + h, terms) for h in range(terms.horizon)]
        np.testing.assert_allclose(y, np.concatenate(slow), rtol=1e-9, atol=1e-12)
        for h in range(terms.horizon):
            features.size_regressors(phi, h, terms, psi)
            np.testing.assert_allclose(psi, slow_sizes(batch.t, x, u, number, h, terms), rtol=1e-7, atol=1e-12)
        plan = u[number + 1 : number + terms.horizon].copy()
        planned_phi = np.empty(terms.total)
        features.present(t, states, inputs, number, terms, planned_phi)
        if planned:
            features.ahead(states, number, plan, terms, planned_phi)
        np.testing.assert_array_equal(planned_phi, phi)


def test_a_sample_is_a_datum_where_all_is_there() -> None:
    terms = FeatureSpec.of(CAR, RegressorSpec.of(CAR), CAR.horizon, planned=True)
    window = Window(CAR, 60)
    window.grow(1)
    x, u = drive(60, 2)
    u[20] = np.nan
    window.append(batch_of(x[:40], u[:40], CAR))
    window.append(batch_of(x[40:], u[40:], CAR, first=41))
    window.gate(np.array([0]), np.array([50]))
    ring = rings(window)
    run, known, gated = ring.run[0], ring.known[0], ring.gated[0]
    linked = np.r_[False, np.ones(39, bool), False, np.ones(19, bool)]
    for number in range(terms.reach, 60 - terms.horizon):
        back = range(number - terms.reach, number)
        complete = all(linked[k + 1] for k in back) and not number - terms.lags <= 20 <= number
        assert features.complete(run, known, number, terms) == complete
        usable = complete and all(linked[number + h] for h in range(1, terms.horizon + 1))
        usable = usable and not number < 20 < number + terms.horizon
        usable = usable and not number - terms.increments <= 50 <= number + terms.horizon
        assert features.usable(run, known, gated, number, terms) == usable


def test_lagged_increments_follow_the_lags_of_inputs() -> None:
    def increments(profile: VehicleProfile) -> int:
        return FeatureSpec.of(profile, RegressorSpec.of(profile), 3, planned=False).increments

    assert [increments(CAR.model_copy(update={"input_lags": lags})) for lags in (0, 4, 8, 25)] == [2, 2, 4, 6]
