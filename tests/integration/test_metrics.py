"""Real services answer Prometheus until they end; who cannot be asked is told so."""

import socket

import pytest

from fleet_bus.router import Router
from tests.integration.conftest import Process, Start, run_fleet
from tests.scrapes import fetch, values
from tests.waiting import wait_until

pytestmark = [pytest.mark.integration, pytest.mark.slow]

SAYS = "metrics on http://127.0.0.1:"


def url_of(process: Process) -> str:
    process.expect(SAYS)
    (line,) = (line for line in process.lines if SAYS in line)
    return line.split()[-1]


def total(url: str, name: str) -> float:
    return sum(value for (known, _), value in values(fetch(url)).items() if known == name)


def test_what_an_agent_publishes_arrives_and_becomes_tubes(router: Router, start: Start) -> None:
    at = ("--router", router.endpoints[0], "--metrics", "0")
    reach = start("reach", *at)
    reach.expect("ready")
    side_info = start("side-info", "parking-lot", *at)
    side_info.expect("publishes")
    agent = start("agent", "--vehicle", "svea1", *at)
    urls = [url_of(process) for process in (reach, side_info, agent)]
    wait_until(lambda: total(urls[0], "fleet_reach_tubes_total") > 10)
    published = total(urls[2], "fleet_agent_published_total")
    wait_until(lambda: total(urls[0], "fleet_reach_states_total") >= published)
    wait_until(lambda: total(urls[0], "fleet_reach_newest_tubes") == 1)
    wait_until(lambda: total(urls[1], "fleet_side_info_vehicles") == 1)
    latency = total(urls[0], "fleet_reach_tube_latency_seconds_count")
    assert 0 < latency <= total(urls[0], "fleet_reach_tubes_total")
    for process in (agent, side_info, reach):
        assert process.end() == 0
    for url in urls:
        with pytest.raises(OSError, match="refused"):
            fetch(url)


@pytest.mark.parametrize(
    "command", [("reach",), ("side-info",), ("agent", "--vehicle", "svea1")], ids=lambda words: str(words[0])
)
def test_a_port_in_use_and_an_address_that_is_none(command: tuple[str, ...], router: Router) -> None:
    at = (*command, "--router", router.endpoints[0])
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = str(taken.getsockname()[1])
        done = run_fleet(*at, "--metrics", port)
    assert done.returncode == 1
    assert f"port {port}" in done.stderr
    assert "choose another port" in done.stderr
    done = run_fleet(*at, "--metrics", "here")
    assert done.returncode == 2
    assert "[HOST:]PORT" in done.stderr
