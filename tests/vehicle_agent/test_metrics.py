"""What agents tell Prometheus, all vehicles of a process taken together."""

from tests.scrapes import agent_text, values
from vehicle_agent.agent import REASONS


def test_it_says_what_was_published_and_what_was_not() -> None:
    found = values(agent_text())
    assert found["fleet_agent_vehicles", ()] == 1
    assert found["fleet_agent_published_total", ()] == 2
    assert found["fleet_agent_filter_restarts_total", ()] == 0
    skipped = {dict(labels)["reason"]: value for (name, labels), value in found.items() if "skipped" in name}
    assert skipped == {**dict.fromkeys(REASONS, 0), "range": 1}
    assert "cart1" not in agent_text()
