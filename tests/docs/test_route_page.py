"""The route of the guide drives, keeps the scenario that it is for, and fails as the guide says."""

import numpy as np
import pytest
import yaml

from fleet_bus.errors import UsageError
from fleet_cli.demo import ROUTES
from reach_server.side_information import first_contradiction
from side_info import Scenario
from tests.docs.test_docs import DOCS, blocks
from vehicle_agent import svea
from vehicle_agent.route import Route, Zone, route_names
from vehicle_agent.simulate import simulate_drive

GUIDE = DOCS / "how-to" / "write-a-route.md"
(TEXT,) = blocks(GUIDE, "yaml")
ROUTE = Route.model_validate(yaml.safe_load(TEXT))


@pytest.mark.parametrize("seed", [1, 2, 3, 4])
def test_it_keeps_the_scenario_of_the_other_guide_and_its_requirements(seed: int) -> None:
    (text,) = blocks(DOCS / "how-to" / "write-a-scenario.md", "yaml")
    profile = svea.profile()
    states = simulate_drive(ROUTE, seed).truth
    stamps = np.arange(len(states)) * profile.sample_time_ns + 1
    asked = yaml.safe_load(text)
    for formula in (asked["assume"], *asked["monitor"].values()):
        scenario = Scenario.parse(yaml.safe_dump({**asked, "assume": formula, "monitor": {}}), "lot")
        assert first_contradiction(scenario, profile, stamps, states, 1) is None, formula


def test_it_fails_as_the_guide_says() -> None:
    (message,) = (block for block in blocks(GUIDE, "text") if block.startswith("error: "))
    # Narrower than any way through it.
    north = {"name": "north", "start": "8 s", "end": "8.5 s", "box": {"y": [2.9, 3.268]}}
    blocked = ROUTE.model_copy(update={"zones": [ROUTE.zones[0], Zone.model_validate(north)]})
    with pytest.raises(UsageError) as refused:
        simulate_drive(blocked, 1)
    assert f"error: {refused.value}\n" == message


def test_the_page_lists_the_fields_and_the_shipped_routes() -> None:
    text = GUIDE.read_text(encoding="utf-8")
    assert all(f"| `{field}` |" in text for field in Route.model_fields)
    assert all(f"| `{name}` | `" in text for name in route_names())
    assert all(f"`{scenario}`" in text for scenario in ROUTES)
    assert all(f"`{form}`" in text for form in ("box", "disc", "ring"))
