"""What is heard on a real bus beside real servers gives the same tubes again."""

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import msgpack
import pytest

from fleet_bus import keys
from fleet_bus.messages import Assignment, ReachTube, ScenarioDocument, StateSample, VehicleProfile
from fleet_bus.messages.state import ENCODING
from fleet_bus.pubsub import Received
from fleet_bus.router import Router
from fleet_bus.sessions import Role
from fleet_bus.zenoh_bus import open_bus
from fleet_recorder.verify import verify
from tests.fleet_recorder.drive import BEFORE, PROFILES, region
from tests.integration.conftest import ROOT, serving
from tests.reach_server.drives import START, SVEA, history
from tests.waiting import wait_until

pytestmark = [pytest.mark.integration, pytest.mark.slow]

#: Verifies messages that lie in a file, in a process of its own.
CHILD = """
import json, sys, msgpack
from fleet_bus.pubsub import Received
from fleet_recorder.verify import verify
with open(sys.argv[1], "rb") as file:
    messages = [Received(*fields) for fields in msgpack.unpack(file)]
print(json.dumps(verify(messages).json()))
"""


@contextmanager
def recording(endpoint: str, heard: list[Received]) -> Iterator[None]:
    """Everything on the bus, as it comes to somebody who is seen as a recorder."""
    with ExitStack() as opening:
        bus = opening.enter_context(open_bus(Role.SERVICE, [endpoint]))
        for expression in ("fleet/*/state", "fleet/*/profile", "spec/**", "reach/**", "svc/**"):
            opening.enter_context(bus.subscriber(expression, heard.append, history=1000, late_publishers=True))
        opening.enter_context(bus.alive(keys.service("recorder", "test")))
        yield


def test_two_servers_over_a_router_one_after_the_other(router: Router, tmp_path: Path) -> None:
    endpoint, heard, drive = router.endpoints[0], list[Received](), history(0)
    cars = {"a": PROFILES["set_membership"], "b": PROFILES["hull"]}
    sent = 0

    def tubes() -> set[tuple[str, int, int]]:
        found = (ReachTube.decode(m.payload) for m in list(heard) if m.key.endswith("/tube"))
        return {(tube.vehicle, tube.seq, tube.server_epoch) for tube in found}

    with ExitStack() as opening:
        opening.enter_context(recording(endpoint, heard))
        agents = {car: opening.enter_context(open_bus(Role.SERVICE, [endpoint])) for car in cars}
        side_info = opening.enter_context(open_bus(Role.SERVICE, [endpoint]))
        states = {}
        for car, bus in agents.items():
            profile = opening.enter_context(bus.publisher(keys.profile(car), VehicleProfile.encoding(), cache=1))
            profile.put(cars[car].encode())
            states[car] = opening.enter_context(bus.publisher(keys.state(car), ENCODING, cache=1000))
        document = opening.enter_context(
            side_info.publisher(keys.document("near"), ScenarioDocument.encoding(), cache=1)
        )
        document.put(region("near", 2.0).encode())
        takes_part = Assignment(scenario="near", vehicle="a", time_zero=START + BEFORE * SVEA.dt_ns)
        assignment = opening.enter_context(
            side_info.publisher(keys.assignment("near", "a"), Assignment.encoding(), cache=1)
        )
        assignment.put(takes_part.encode())

        def drives(samples: int) -> None:
            nonlocal sent
            for k in range(sent, sent + samples):
                plan = drive.inputs[k + 1 : k + 10]
                sample = StateSample(
                    1, k, START + k * SVEA.dt_ns, drive.measured[k], drive.inputs[k],
                    plan=plan, plan_tolerance=0.0 * plan[0],
                )  # fmt: skip
                for publisher in states.values():
                    publisher.put(sample.encode())
            sent += samples

        drives(BEFORE)
        for _ in range(2):
            before = tubes()
            with serving(endpoint, "one"):
                wait_until(lambda: any(m.key.endswith("/checkpoint") for m in list(heard)))
                while len(tubes() - before) < 30:
                    drives(1)
                    wait_until(lambda: {(car, sent - 1) for car in cars} <= {tube[:2] for tube in tubes()})
    report = verify(heard)
    assert report.equal, "\n".join(report.lines())
    assert len(report.stretches) == 2
    assert report.total("tubes") >= 50
    assert report.recorded == report.total("tubes")

    # In another process texts have other hashes, and sets of them another order.
    file = tmp_path / "heard"
    file.write_bytes(
        msgpack.packb([[m.key, m.payload, m.encoding, m.timestamp_ns, m.source, m.arrived_ns] for m in heard])
    )
    for seed in ("1", "2"):
        done = subprocess.run(
            [sys.executable, "-c", CHILD, str(file)], capture_output=True, text=True, cwd=ROOT, check=True,
            env={**os.environ, "PYTHONHASHSEED": seed},
        )  # fmt: skip
        found = json.loads(done.stdout.splitlines()[-1])
        assert found["equal"], found
        assert found["tubes"] == report.total("tubes")
