"""The example that publishes, run against a router and a server that knows nothing of it."""

import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fleet_bus import Role, keys, open_session
from fleet_bus.messages import ReachTube, StateFlag, StateSample, VehicleProfile
from fleet_bus.pubsub import Received, declare_recovering_subscriber
from fleet_bus.router import Router
from tests.integration.conftest import serving
from tests.waiting import wait_until

EXAMPLE = Path(__file__).parents[2] / "docs" / "examples" / "publish_state.py"
#: Seconds for anything; nothing depends on how fast it is.
LONG = 120.0


def names() -> dict[str, Any]:
    """What the example defines."""
    found: dict[str, Any] = {"__name__": "example"}
    exec(EXAMPLE.read_text(encoding="utf-8"), found)
    return found


def test_its_messages_are_read_as_they_are_meant() -> None:
    example = names()
    payload = example["state_message"](7, 3, 10**18, [1.0, 2.0, 3.0, 4.0], [5.0, 6.0], 8)
    sample = StateSample.decode(payload)
    assert (sample.epoch, sample.seq, sample.t, sample.flags) == (7, 3, 10**18, StateFlag.HISTORY)
    assert (sample.x.tolist(), sample.u.tolist()) == ([1.0, 2.0, 3.0, 4.0], [5.0, 6.0])
    profile = VehicleProfile.decode(example["msgpack"].packb(example["PROFILE"]))
    assert profile.state_names == ("x", "y", "vx", "vy")
    assert profile.input_names == ("ax", "ay")
    # The form in which states are read in batches is the one that this project writes.
    assert StateSample(7, 3, 10**18, sample.x, sample.u, StateFlag.HISTORY).encode() == payload


def test_the_cart_keeps_to_what_its_profile_states() -> None:
    example = names()
    samples = example["drive"](example["random"].Random(1))
    states, inputs = zip(*(next(samples) for _ in range(3000)), strict=True)
    x, u = np.array(states), np.array(inputs)
    measured = np.array(example["MEASUREMENT"])
    assert (np.abs(x[:, 2:]) + measured[2:] < 2.0).all()
    assert (np.abs(u) <= 1.5).all()
    # The linear model that the profile speaks of leads from each state to the next one within the bounds of both.
    dt = example["SAMPLE_TIME"]
    a, b = np.eye(4) + dt * np.eye(4, k=2), np.vstack((dt**2 / 2 * np.eye(2), dt * np.eye(2)))
    off = np.abs(x[1:] - x[:-1] @ a.T - u[:-1] @ b.T)
    assert (off <= measured + np.abs(a) @ measured + example["PROCESS"]).all()


@pytest.mark.slow
@pytest.mark.integration
def test_a_server_makes_guaranteed_tubes_of_it() -> None:
    tubes: list[ReachTube] = []

    def take(received: Received) -> None:
        tubes.append(ReachTube.decode(received.payload))

    with Router(["tcp/127.0.0.1:0"]) as router, serving(router.endpoints[0]):
        with (
            open_session(Role.VIEWER, router.endpoints) as session,
            declare_recovering_subscriber(session, keys.tube("cart7"), take, history=0),
            subprocess.Popen(
                [sys.executable, str(EXAMPLE), "--router", router.endpoints[0], "--vehicle", "cart7"],
                stderr=subprocess.PIPE,
                text=True,
            ) as process,
        ):
            try:
                wait_until(lambda: tubes and tubes[-1].audit.checked >= 3, LONG)
            finally:
                process.terminate()
    last = tubes[-1]
    assert (last.method, last.label) == ("lti", "guaranteed")
    assert last.audit.inside == last.audit.checked
    assert last.state_names == ("x", "y", "vx", "vy")
    assert last.verdicts == {}
