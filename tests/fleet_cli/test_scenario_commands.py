"""fleet scenario list, check and show, in this process."""

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner, Result

from fleet_bus.errors import ProfileError, ScenarioError, UsageError
from fleet_cli import scenario_files
from fleet_cli.main import app
from side_info import Scenario, shipped

TOUCHING = """\
# Two boxes that touch in time.
scenario: touching
version: 3
state: {x1: m, x2: m}
time: {zero: on_start, semantics: sampled}
regions:
  P: {box: {x1: [0, 1]}}
  O: {box: {x1: [1, 2]}}
assume: always[0:1 s](P) and always[1:2 s](O)
monitor: {early: "eventually[0:0.5 s](O)"}
"""


def fleet(*arguments: str) -> Result:
    return CliRunner().invoke(app, ["scenario", *arguments])


def wrong(*arguments: str) -> Exception:
    found = fleet(*arguments).exception
    assert isinstance(found, Exception)
    return found


@pytest.fixture
def touching(tmp_path: Path) -> Path:
    path = tmp_path / "touching.yaml"
    path.write_text(TOUCHING, encoding="utf-8")
    return path


def test_list_says_what_each_is_about() -> None:
    lines = fleet("list").stdout.splitlines()
    assert tuple(line.split()[0] for line in lines) == shipped()
    assert "The parking lot of the paper, formula phi_p" in lines[shipped().index("parking-lot")]
    document = json.loads(fleet("list", "--json", "-").stdout)
    assert [entry["scenario"] for entry in document] == list(shipped())
    assert all(entry["description"] in line for entry, line in zip(document, lines, strict=True))


def test_what_has_no_comment_is_described_by_what_it_holds() -> None:
    scenario = Scenario.parse(TOUCHING[TOUCHING.index("scenario:") :])
    assert scenario_files.describe(scenario) == "2 predicates over 2 s, 1 monitor"


def test_check_tells_a_line_for_each_and_what_is_remarkable(touching: Path) -> None:
    done = fleet("check", "roundabout", str(touching), "--sample-time", "0.05")
    assert done.exit_code == 0, done.output
    assert "roundabout v2: " in done.stdout
    assert "touching v3: 2 predicates over 2 s, 1 monitor" in done.stdout
    assert f"{touching}:9:" in done.stdout
    document = json.loads(fleet("check", str(touching), "--json", "-").stdout)
    (found,) = document["scenarios"]
    assert (found["scenario"], found["version"], found["end"]) == ("touching", 3, 2.0)
    assert found["predicates"] == ["P.x1", "O.x1"]
    assert found["warnings"][0]["line"] == 9
    assert document["errors"] == []


def test_check_tells_all_errors_with_their_places(touching: Path, tmp_path: Path) -> None:
    bad, worse = tmp_path / "bad.yaml", tmp_path / "worse.yaml"
    bad.write_text(TOUCHING.replace("always[1:2 s](O)", "always[1:2 s](Q)"), encoding="utf-8")
    worse.write_text(TOUCHING.replace("version: 3", "version: 0"), encoding="utf-8")
    done = fleet("check", str(bad), str(touching), str(worse))
    assert isinstance(done.exception, ScenarioError)
    assert "bad.yaml:9:44: 'Q' is not declared" in str(done.exception)
    assert "worse.yaml:3:10" in str(done.exception)
    assert "touching v3" in done.stdout
    document = json.loads(fleet("check", str(bad), "--json", "-").stdout)
    assert document["scenarios"] == []
    assert "bad.yaml:9:44" in document["errors"][0]


def test_check_against_a_profile() -> None:
    assert fleet("check", "convoy", "--profile", "svea").exit_code == 0
    assert "its state 'x1' is no state of class dart" in str(wrong("check", "convoy", "--profile", "dart"))
    assert isinstance(wrong("check", "convoy", "--profile", "nowhere"), ProfileError)


@pytest.mark.parametrize("time", ["inf", "nan", "0", "-1"])
@pytest.mark.parametrize("command", ["check", "show"])
def test_a_sample_time_that_is_none_is_refused(command: str, time: str) -> None:
    done = fleet(command, "roundabout", "--sample-time", time)
    assert done.exit_code == 2
    assert "--sample-time" in done.output


@pytest.mark.parametrize("offset", ["inf", "nan", "-1"])
def test_a_clock_offset_that_is_none_is_refused(offset: str) -> None:
    done = CliRunner().invoke(app, ["side-info", "roundabout", "--clock-offset", offset])
    assert done.exit_code == 2
    assert "--clock-offset" in done.output


def test_a_vehicle_is_assigned_once() -> None:
    names = ["roundabout", "parking-lot", "--assign", "a1=roundabout", "--assign", "a1=parking-lot"]
    problem = CliRunner().invoke(app, ["side-info", *names]).exception
    assert isinstance(problem, UsageError)
    assert "--assign: a1 is assigned twice (roundabout, parking-lot); one service gives a vehicle one" in str(problem)


def test_show_prints_formula_predicates_and_windows(touching: Path) -> None:
    done = fleet("show", str(touching), "--sample-time", "0.5")
    assert done.exit_code == 0, done.output
    for words in ("touching v3", "Two boxes that touch in time", "always[0:1](P)", "early: eventually[0:0.5](O)"):
        assert words in done.stdout
    rows = {line.split("│")[1].strip(): line for line in done.stdout.splitlines() if "│" in line}
    assert "0 <= x1 <= 1" in rows["P.x1"]
    assert "0–1" in rows["P.x1"]
    assert "1–2" in rows["O.x1"]
    assert f"{touching}:9:" in done.stdout


@pytest.mark.parametrize("name", shipped())
@pytest.mark.parametrize("suffix", ["png", "svg"])
@pytest.mark.slow
def test_show_draws(name: str, suffix: str, tmp_path: Path) -> None:
    path = tmp_path / f"picture.{suffix}"
    done = fleet("show", name, "-o", str(path), "--sample-time", "0.25")
    assert done.exit_code == 0, done.output
    assert f"picture: {path}" in done.stdout
    assert path.stat().st_size > 10_000


def test_where_it_cannot_be_drawn(tmp_path: Path) -> None:
    problem = wrong("show", "roundabout", "-o", str(tmp_path / "picture.odd"))
    assert isinstance(problem, UsageError)
    assert "choose a .png, .svg or .pdf file" in str(problem)
    assert isinstance(wrong("show", "nowhere"), ScenarioError)
