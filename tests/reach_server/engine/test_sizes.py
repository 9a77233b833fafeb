"""What a class takes of a server's memory, and how large its sets and tubes may become."""

from itertools import chain
from typing import Any

import numpy as np
import pytest

from fleet_bus.errors import UsageError
from fleet_bus.messages import Audit, Label, ReachTube, VehicleProfile, parse_profile, ranges
from reach_server.engine.engine import Engine
from reach_server.models.conformal import ConformalPredictor
from reach_server.service.tube_messages import messages
from reach_server.tube.summaries import EXTRA_GENERATORS, OUTLINE
from tests.reach_server.drives import World, samples_of

METHODS = ("calibrated", "set_membership", "residual_hull", "lti")


def class_of(rng: np.random.Generator, method: str) -> VehicleProfile:
    n, m = int(rng.integers(1, 9)), int(rng.integers(0, 4))
    fields: dict[str, Any] = {
        "class": "some", "state": {f"x{i}": "m" for i in range(n)}, "sample_time": 0.1,
        "inputs": {f"u{i}": {"unit": "m", "limits": [-1, 1]} for i in range(m)},
        "future_inputs": str(rng.choice(["limits", "plan"])), "input_lags": int(rng.integers(0, 33)),
        "window": int(10 ** rng.uniform(3, 4)), "reservoir": int(rng.choice([0, 500, 5000])),
        "nearest": int(rng.choice([1, 64, 3000])), "horizon": int(rng.integers(1, 30)), "method": method,
        "confidence": 0.9, "margin": str(rng.choice(["step", "tube"])),
    }  # fmt: skip
    p = n + (fields["input_lags"] + 1) * m
    fields["lipschitz"] = {"matrix": [[1.0] * p] * n}
    return parse_profile(fields)


def kept(engine: Engine) -> int:
    """Bytes of the arrays that an engine has made for its vehicles."""
    found, waiting, seen = 0, [engine.window, engine._method], set()
    while waiting:
        one = waiting.pop()
        if id(one) in seen or isinstance(one, VehicleProfile):
            continue
        seen.add(id(one))
        if isinstance(one, np.ndarray):
            found += one.nbytes
        elif isinstance(one, tuple | list):
            waiting += list(one)
        elif isinstance(one, dict):
            waiting += list(one.values())
        elif type(one).__module__.startswith("reach_server"):
            names = chain.from_iterable(getattr(kind, "__slots__", ()) for kind in type(one).__mro__)
            waiting += [getattr(one, name) for name in names if hasattr(one, name)]
            waiting += list(getattr(one, "__dict__", {}).values())
    return found


@pytest.mark.parametrize("method", METHODS)
def test_a_class_takes_no_more_memory_than_its_profile_says(method: str) -> None:
    rng, tried = np.random.default_rng(METHODS.index(method)), 0
    while tried < 12:
        try:
            engine = Engine(class_of(rng, method))
        except UsageError:
            # A window that is too short for so many features.
            continue
        before = kept(engine)
        engine.add("a")
        taken = kept(engine) - before
        profile = engine.profile
        if method == "calibrated":
            assert isinstance(models := engine._method._models, ConformalPredictor)  # type: ignore[attr-defined]
            assert taken >= models.bytes_per_vehicle
        # What the nearest data of a tube and its fit take is made anew for each.
        passing = 8 * profile.nearest * (len(profile.regressors) + len(profile.state))
        assert taken + passing * (method in ("set_membership", "residual_hull")) <= profile.memory, profile
        tried += 1


def test_a_tube_is_no_longer_than_its_profile_says() -> None:
    rng = np.random.default_rng(0)
    for n, horizon in ((1, 200), (4, 200), (6, 120), (12, 40), (32, 8)):
        fields = {
            "class": "some", "state": {f"a{'x' * 27}{i:02}": "m" for i in range(n)}, "sample_time": 1.0,
            "horizon": horizon,
        }  # fmt: skip
        profile = parse_profile(fields)
        center, generators = rng.normal(size=(horizon, n)), rng.normal(size=(horizon, n, n + EXTRA_GENERATORS))
        tube = ReachTube(
            "v" * 64, int(ranges.EPOCH.high), int(ranges.SEQ.high), int(ranges.TIME.high), np.full(horizon, 2**62),
            profile.state_names, profile.position, "set_membership", Label.CALIBRATED, center, generators,
            rng.normal(size=(horizon, 2, n)), rng.normal(size=(horizon, OUTLINE, 2)), *(np.ones(horizon),) * 2,
            notes=("n" * 200,) * 4, verdicts={f"{i}.{'r' * 64}": "undecided (time)" for i in range(30)},
            audit=Audit(*(int(ranges.COUNTER.high),) * 2, 1.5, 1000, 1000, 1000), server="s" * 64,
            server_epoch=int(ranges.EPOCH.high), compute_seconds=0.1,
        )  # fmt: skip
        assert len(tube.encode()) <= profile.tube_bytes <= ranges.TUBE_BYTES.high


def test_sets_that_no_message_holds_are_not_published() -> None:
    world = World()
    fields = world.profile.model_dump(mode="json", by_alias=True, exclude_none=True)
    fields["lipschitz"] = {"matrix": [[1e20] * 4] * 2, "origin": "given"}
    drive = world.drive(0)
    for horizon, published in ((1, True), (6, False)):
        engine = Engine(parse_profile({**fields, "horizon": horizon, "method": "set_membership"}))
        engine.add("a")
        tubes = engine.step(samples_of(drive, 0, 100))
        assert tubes.vehicles == ("a",) * published
        assert ("grow beyond all numbers" in tubes.waiting.get("a", "")) == (not published)
        audits = [Audit()] * len(tubes.vehicles)
        sent = list(messages(tubes, ("a", "b"), (0, 1), audits, server="s", server_epoch=1, compute_seconds=0.0))
        assert [ReachTube.decode(tube.encode()).vehicle for tube in sent] == list(tubes.vehicles)
