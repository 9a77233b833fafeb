"""Predicates speak about true states, calibrated sets about measured ones."""

from itertools import islice

import numpy as np
import pytest

from fleet_bus.messages import StateSample
from fleet_bus.messages.profile import Noise
from reach_server.data.window import SampleBatch
from reach_server.engine.engine import Engine
from side_info import Scenario
from vehicle_agent import svea
from vehicle_agent.route import load_route
from vehicle_agent.sources import SimulatedSource

START = 10**18


@pytest.mark.parametrize("stated", [True, False])
@pytest.mark.slow
def test_calibrated_sets_are_cut_only_where_the_measurement_noise_is_stated(stated: bool) -> None:
    profile = svea.profile()
    if not stated:
        profile = profile.model_copy(update={"noise": Noise()})
    engine = Engine(profile, method="calibrated", planned=False)
    slot = engine.add("car")
    engine.assign("car", Scenario.load("parking-lot"), START)
    readings = list(islice(iter(SimulatedSource(load_route("parking-lot"), 3)), 1024 + 800))
    samples = [StateSample(1, i, START + r.t, r.measured, r.u, r.flags) for i, r in enumerate(readings)]
    engine.append(SampleBatch.of(slot, samples[:1500]))
    active = 0
    for sample in samples[1500:1700]:
        tubes = engine.step(SampleBatch.of(slot, [sample]))
        assert not tubes.events
        active += bool(tubes.cuts[0])
        smaller = (tubes.area < tubes.area_free).any()
        assert bool(tubes.cuts[0]) or not smaller
        np.testing.assert_array_less(tubes.area, tubes.area_free * (1 + 1e-9))
    assert (active > 0) == stated
