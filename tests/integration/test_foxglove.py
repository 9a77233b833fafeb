"""``fleet foxglove`` as its user runs it: a router, a reach server, an agent, and a client of another make."""

import re
import socket

import numpy as np
import pytest

from fleet_bus import keys
from fleet_bus.messages import ReachTube
from fleet_bus.pubsub import Received, subscribe
from fleet_bus.router import Router
from fleet_bus.sessions import Role, open_session
from fleet_foxglove import topics
from fleet_foxglove.messages import ALL_TOPICS, Scene
from tests.fleet_foxglove.client import Client, connected
from tests.integration.conftest import Process, Start, run_fleet, serving
from tests.waiting import DEADLINE, wait_until

pytestmark = [pytest.mark.integration, pytest.mark.slow]


def port_of(process: Process) -> int:
    """Port that a started ``fleet foxglove`` says."""
    process.expect("foxglove connects to ws://127.0.0.1:")
    (found,) = [match for line in process.lines if (match := re.search(r"ws://127\.0\.0\.1:(\d+)", line))]
    return int(found[1])


def test_a_client_sees_the_tubes_of_a_running_fleet(router: Router, start: Start) -> None:
    endpoint = router.endpoints[0]
    came: dict[tuple[int, int], Received] = {}

    def keep(received: Received) -> None:
        tube = ReachTube.decode(received.payload, received.encoding)
        came[tube.epoch, tube.seq] = received

    with (
        serving(endpoint),
        open_session(Role.VIEWER, [endpoint]) as session,
        subscribe(session, keys.tube("svea1"), keep),
    ):
        process = start("foxglove", "--port", "0", "--router", endpoint)
        port = port_of(process)
        start("side-info", "parking-lot", "--router", endpoint).expect("side-info publishes")
        start("agent", "--vehicle", "svea1", "--source", "sim", "--router", endpoint)
        with connected(port, len(ALL_TOPICS)) as client:
            client.subscribe(*sorted(ALL_TOPICS))
            check_scene(client, came)
            transform = client.next(lambda m: m.topic == topics.TRANSFORMS).content
            assert transform["child_frame_id"] == "vehicle/svea1"
            regions = client.next(lambda m: m.topic == topics.REGIONS).content
            assert regions["entities"][0]["id"] == "scenario/parking-lot"
        assert process.end() == 0


def check_scene(client: Client, came: dict[tuple[int, int], Received]) -> None:
    """Whether a scene with an arrow is what the tube on the bus says, and what is recorded of it."""
    message = client.next(lambda m: m.topic == topics.SCENE and len(m.content["entities"]) == 2)
    entity, heading = message.content["entities"]
    assert (entity["id"], heading["id"]) == ("tube/svea1", "heading/svea1")
    about = {pair["key"]: pair["value"] for pair in entity["metadata"]}
    epoch, seq = map(int, about["sample"].split("/"))
    wait_until(lambda: (epoch, seq) in came)
    received = came[epoch, seq]
    tube = ReachTube.decode(received.payload, received.encoding)
    assert len(entity["lines"]) == len(tube.times)
    for line, center, outline in zip(entity["lines"], tube.center, tube.outline, strict=True):
        assert (line["pose"]["position"]["x"], line["pose"]["position"]["y"]) == tuple(center[list(tube.position)])
        assert np.array_equal([[p["x"], p["y"]] for p in line["points"]], outline.astype(np.float64))
    # Of the same tube another reader, without the profile, makes the same but for the arrow.
    (recorded,) = Scene().scene_messages(received, {topics.SCENE})
    assert message.payload.startswith(recorded.payload)


def test_a_port_in_use_ends_it_at_once(router: Router) -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = str(taken.getsockname()[1])
        done = run_fleet("foxglove", "--port", port, "--router", router.endpoints[0])
    assert done.returncode == 1
    assert f"port {port} of 127.0.0.1 is in use" in done.stderr


def test_no_router_is_said(start: Start) -> None:
    done = run_fleet("foxglove", "--port", "0", "--router", "tcp/127.0.0.1:1", timeout=DEADLINE)
    assert done.returncode == 1
    assert "no router answers" in done.stderr


@pytest.mark.parametrize("options", [("--rate", "0.5"), ("--port", "70000"), ("--port", "-1"), ("--rate", "nan")])
def test_options_out_of_range_are_wrong_use(options: tuple[str, str]) -> None:
    assert run_fleet("foxglove", *options).returncode == 2
