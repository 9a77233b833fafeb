"""Wrong use and missing things: a message that says what to do, and the right exit code."""

from pathlib import Path

import pytest

from fleet_bus.router import Router
from tests.integration.conftest import RECORDINGS, Start, read_json, run_fleet

pytestmark = pytest.mark.integration

UNKNOWN_STATE = """
scenario: odd
version: 1
state: {x1: m}
time: {zero: on_start, semantics: sampled}
regions: {P: {box: {x9: [0, 1]}}}
assume: always[0:1 s](P)
"""


def test_no_router() -> None:
    done = run_fleet("reach", "--router", "tcp/127.0.0.1:1")
    assert done.returncode == 1
    assert "fleet router" in done.stderr


def test_port_in_use(router: Router) -> None:
    port = router.endpoints[0].rsplit(":", 1)[1]
    done = run_fleet("router", "--port", port)
    assert done.returncode == 1
    assert port in done.stderr
    assert "--port" in done.stderr


def test_router_prints_its_endpoint_and_ends_cleanly(start: Start) -> None:
    process = start("router", "--port", "0")
    process.expect("router listens on tcp/127.0.0.1:")
    assert process.end() == 0


def test_scenario_with_an_unknown_state_is_refused_at_its_place(tmp_path: Path, router: Router) -> None:
    path = tmp_path / "odd.yaml"
    path.write_text(UNKNOWN_STATE, encoding="utf-8")
    done = run_fleet("side-info", str(path), "--router", router.endpoints[0])
    assert done.returncode == 2
    assert "x9" in done.stderr
    assert "odd.yaml:6" in done.stderr


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["agent", "--vehicle", "a b"], "letters"),
        (["agent", "--vehicle", "car", "--source", "magic"], "recording"),
        (["agent", "--vehicle", "car", "--profile", "nowhere.yaml"], "svea"),
        (["agent", "--vehicle", "car", "--route", "nowhere"], "parking-lot"),
        (["agent", "--vehicle", "car", "--router", "somewhere"], "endpoint"),
        (["demo", "--scenario", "moon"], "parking-lot"),
        (["side-info", "moon"], "parking-lot"),
        (["side-info", "parking-lot", "--assign", "car"], "VEHICLE=SCENARIO"),
        (["evaluate", str(RECORDINGS / "fix_dart_free.npz"), "--profile", "f1tenth"], "v_encoder"),
        (["evaluate", str(RECORDINGS / "fix_dart_free.npz"), "--profile", "dart", "--method", "magic"], "magic"),
        (["evaluate", str(RECORDINGS / "README.md"), "--profile", "dart"], "npz"),
        (["replay", str(RECORDINGS / "fix_dart_free.npz"), "--profile", "dart", "--speed", "0"], "speed"),
    ],
)
def test_wrong_use_says_what_to_do(arguments: list[str], said: str) -> None:
    done = run_fleet(*arguments)
    assert done.returncode == 2, done.stdout + done.stderr
    assert said.lower() in done.stderr.lower()
    assert "Traceback" not in done.stderr


def test_scenario_commands() -> None:
    listed = run_fleet("scenario", "list")
    assert {"parking-lot", "roundabout"} <= set(listed.stdout.split())
    checked = run_fleet("scenario", "check", "parking-lot", "roundabout", "--profile", "svea")
    assert checked.returncode == 0
    assert "parking-lot v2" in checked.stdout


def test_a_bad_scenario_ends_with_its_place_and_exit_code_2(tmp_path: Path) -> None:
    path = tmp_path / "odd.yaml"
    path.write_text(UNKNOWN_STATE, encoding="utf-8")
    checked = run_fleet("scenario", "check", "roundabout", str(path))
    assert checked.returncode == 2
    assert "roundabout v2" in checked.stdout
    assert "odd.yaml:6" in checked.stderr
    assert "x9" in checked.stderr
    assert run_fleet("scenario", "show", str(path)).returncode == 2


def test_evaluate_sets_methods_side_by_side(tmp_path: Path) -> None:
    path = tmp_path / "figures.json"
    done = run_fleet(
        "evaluate", str(RECORDINGS / "fix_upenn_pf.npz"), "--profile", "upenn", "--horizon", "3", "--json", str(path)
    )
    assert done.returncode == 0, done.stderr
    document = read_json(path)
    assert document["horizon"] == 3
    assert set(document["methods"]) == {"paper", "default"}
    for method in document["methods"].values():
        assert [step["step"] for step in method["steps"]] == [1, 2, 3]
        assert all(0 < step["inside"] <= step["checked"] and step["area_mean"] > 0 for step in method["steps"])
        assert sum(method["label_counts"].values()) > 0
    labels = document["methods"]["default"]["label_counts"]
    assert labels.keys() <= {"calibrated", "uncovered"}
    assert labels["calibrated"] > 0.9 * sum(labels.values())
    assert "paper" in done.stdout
