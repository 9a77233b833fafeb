"""The demo is the product in small: every true state inside, side information makes sets smaller."""

from pathlib import Path

import pytest

from fleet_cli.demo import ROUTES
from tests.integration.conftest import read_json, run_fleet

pytestmark = pytest.mark.integration


@pytest.mark.parametrize("scenario", sorted(ROUTES))
def test_demo_holds_what_it_promises(scenario: str, tmp_path: Path) -> None:
    summary_file, picture = tmp_path / "out.json", tmp_path / "demo.png"
    done = run_fleet(
        "demo", "--headless", "--scenario", scenario, "--duration", "10", "--vehicles", "2",
        "--json", str(summary_file), "--picture", str(picture),
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    summary = read_json(summary_file)
    assert summary["failures"] == []
    for vehicle in summary["by_vehicle"].values():
        assert vehicle["tubes"] > 20
        assert vehicle["checked"] > 20
        assert vehicle["inside"] == vehicle["checked"]
        assert vehicle["label"] == "guaranteed"
    assert summary["horizon"]["inside"] == summary["horizon"]["checked"] > 200
    last = summary["area"]["10"]
    assert 0 < last["with"] < last["without"]
    assert "m² with side information" in done.stdout
    assert picture.stat().st_size > 10_000
    steps = summary["evaluation"]["methods"]["default"]["steps"]
    assert [step["step"] for step in steps] == list(range(1, 11))


def test_a_vehicle_that_leaves_its_scenario_is_told_about(tmp_path: Path) -> None:
    summary_file = tmp_path / "out.json"
    done = run_fleet(
        "demo", "--headless", "--duration", "10", "--vehicles", "2", "--stray", "1", "--json", str(summary_file),
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    stray = read_json(summary_file)["stray"]["svea2"]
    # At the sample at which the vehicle is out by more than the noise, or before if no way in is left to it.
    assert stray["told_at"] <= stray["left_at"] + 0.2
    assert stray["predicates"]
    assert stray["inside"] == stray["checked"] > 20
    assert "svea2 strays" in done.stdout
