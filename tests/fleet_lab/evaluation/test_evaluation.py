"""Figures of an evaluation, and the command that prints, writes and draws them."""

import json
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner, Result

from fleet_bus.errors import RecordingError, UsageError
from fleet_cli.main import app
from fleet_lab.evaluation import Settings, evaluate, plan_trials
from fleet_lab.evaluation.figures import ROLLING, ROLLING_LEAST, Checks, Tally, by_run, rolling
from tests.fleet_lab.evaluation.test_evaluation_runs import PROFILE
from tests.fleet_lab.wavy import wavy, write

PROFILE_TEXT = """
class: wavy
state:  {x: m, y: m, yaw: {unit: rad, angle: true}, v: m/s}
inputs: {steering: rad, velocity: m/s}
sample_time: 50 ms
frame: body
window: 400
confidence: 0.9
future_inputs: learned
roles: {position: [x, y], heading: yaw, speed: v, steering: steering}
"""


def checks(inside: list[bool], run: list[int] | None = None, checked: list[bool] | None = None) -> Checks:
    """One step, unit boxes; what is inside lies in the middle, what is not 2 off the centre."""
    held = np.array(inside)[:, None]
    count = len(held)
    return Checks(
        "drive",
        np.arange(count) + 100,
        np.zeros(count, dtype=np.int64) if run is None else np.array(run),
        np.ones((count, 1), dtype=bool) if checked is None else np.array(checked)[:, None],
        held,
        np.full((count, 1), 3.0),
        np.full((count, 1), 4.0),
        np.where(held[..., None], [0.5, 0.0], [0.0, 2.0]),
        (np.broadcast_to(np.eye(2), (count, 2, 2)),),
    )


def test_short_runs_are_judged_together() -> None:
    found = by_run([checks([True] * 99 + [False], run=[0] * 40 + [1] * 10 + [2] * 25 + [3] * 25)])
    assert [run.runs for run in found] == [(0,), (1, 2, 3)]
    assert [run.checked for run in found] == [(40,), (60,)]
    assert [run.inside for run in found] == [(40,), (59,)]
    assert found[1].name == "drive run 1–3"


def test_a_short_end_joins_the_run_before() -> None:
    found = by_run([checks([True] * 50, run=[4] * 35 + [7] * 15)])
    assert [run.runs for run in found] == [(4, 7)]


def test_step_figures() -> None:
    tally = Tally([checks([True] * 60 + [False] * 40, run=[0] * 50 + [1] * 50)], seconds=[1e-3, 3e-3])
    step = tally.figures(1, 0.5).steps[0]
    assert (step.checked, step.inside, step.area_mean, step.area_median) == (100, 60, 3.0, 3.0)
    assert (step.worst_run, step.worst_run_name) == (0.2, "drive run 1")
    # Half of the states lie within half of the box, and the checked sets have area 4.
    assert step.factor == pytest.approx(0.5, rel=5e-3)
    assert step.area_equal == pytest.approx(1.0, rel=1e-2)
    assert tally.figures(1, 0.99).steps[0].factor == pytest.approx(2.0, rel=5e-3)


def test_what_was_not_checked_does_not_count() -> None:
    tally = Tally([checks([True] * 50 + [False] * 50, checked=[True] * 50 + [False] * 50)], seconds=[1e-3])
    step = tally.figures(1, 0.99).steps[0]
    assert (step.checked, step.inside, step.worst_run) == (50, 50, 1.0)
    none = Tally([checks([False] * 5, checked=[False] * 5)], seconds=[1e-3]).figures(1, 0.99).steps[0]
    assert (none.checked, none.factor, none.area_equal, none.worst_run) == (0, None, None, None)


def test_rolling_coverage_is_that_of_the_newest_checks() -> None:
    inside = np.random.default_rng(2).random(700) < 0.9
    checked = np.random.default_rng(3).random(700) < 0.7
    found = rolling(checks(inside.tolist(), checked=checked.tolist()))
    for sample, share in zip(found.sample, found.steps[1], strict=True):
        newest = inside[: sample - 99][checked[: sample - 99]][-ROLLING:]
        assert len(newest) >= ROLLING_LEAST
        assert share == pytest.approx(newest.mean())


def test_nothing_predicted_says_why() -> None:
    tally = Tally()
    tally.waiting["too few samples"] = 7
    with pytest.raises(RecordingError, match=r"--train.*7 samples: too few samples"):
        tally.figures(3, 0.99)


@pytest.mark.slow
def test_evaluation_of_methods() -> None:
    trials = plan_trials([wavy(560, runs=4)], PROFILE, train_runs="even")
    told: list[tuple[str, int, int]] = []
    figures = evaluate(trials, PROFILE, Settings(("calibrated", "paper"), 3), lambda *a: told.append(a))
    assert set(figures) == {"calibrated", "paper"}
    for name, method in figures.items():
        assert [step.step for step in method.steps] == [1, 2, 3]
        assert sum(method.label_counts.values()) + sum(method.waiting.values()) == 280
        for step in method.steps:
            assert 0.6 * step.checked <= step.inside <= step.checked
            assert sum(run.checked[step.step - 1] for run in method.runs) == step.checked
            assert step.factor is not None
            assert step.area_equal is not None
        assert told[-1][1:] == (280, 280) or name == "calibrated"
    areas = [figures[name].steps[2].area_equal or np.inf for name in ("calibrated", "paper")]
    assert areas[0] < 0.5 * areas[1]


@pytest.mark.slow
def test_frozen_learns_nothing_from_what_is_tested() -> None:
    # The tested runs have steering of the other sign: only a model that learns gets better.
    one = wavy(600, runs=2)
    turned = np.where(one.segment[:, None] == 1, one.u * [-1.0, 1.0], one.u)
    object.__setattr__(one, "u", turned)
    trials = plan_trials([one], PROFILE, train_runs="0")
    shares = []
    for frozen in (False, True):
        method = evaluate(trials, PROFILE, Settings(("calibrated",), 2, frozen=frozen))["calibrated"]
        shares.append(method.rolling[0].steps[1][-1])
    assert shares[0] > shares[1] + 0.2


@pytest.fixture
def drive(tmp_path: Path) -> Path:
    (tmp_path / "wavy.yaml").write_text(PROFILE_TEXT, encoding="utf-8")
    return write(wavy(600, runs=4), tmp_path / "wavy.npz")


def fleet(drive: Path, *arguments: str) -> Result:
    profile = str(drive.with_name("wavy.yaml"))
    return CliRunner().invoke(app, ["evaluate", str(drive), "--profile", profile, "--horizon", "2", *arguments])


@pytest.mark.slow
def test_the_command_prints_writes_and_draws(drive: Path, tmp_path: Path) -> None:
    document, picture = tmp_path / "figures.json", tmp_path / "figures.png"
    done = fleet(
        drive, "--train-runs", "even", "--method", "residual_hull", "--method", "calibrated",
        "--json", str(document), "--picture", str(picture),
    )  # fmt: skip
    assert done.exit_code == 0, done.output
    for words in ("wavy.npz · class wavy", "residual_hull", "worst run", "ratio", f"picture: {picture}"):
        assert words in done.stdout
    found = json.loads(document.read_text(encoding="utf-8"))
    assert (found["profile"], found["horizon"], found["confidence"]) == ("wavy", 2, 0.9)
    for method in found["methods"].values():
        assert {"steps", "update_us_median", "label_counts", "runs", "rolling", "events", "waiting"} <= method.keys()
        assert {run["recording"] for run in method["runs"]} == {"wavy"}
        assert method["rolling"][0]["steps"].keys() == {"1"}
    assert picture.stat().st_size > 10_000


def test_json_alone_on_stdout(drive: Path) -> None:
    done = fleet(drive, "--method", "calibrated", "--run-seconds", "5", "--train-runs", "first:0.6", "--json", "-")
    assert json.loads(done.stdout)["methods"]["calibrated"]["steps"][0]["checked"] > 0


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--train-runs", "all"], "even, odd"),
        (["--test-runs", "9"], "runs 0 to 3"),
        (["--json", "/nowhere/figures.json"], "no folder"),
        (["--picture", "/nowhere/figures.png"], "no folder"),
        (["--inputs", "none"], "learned"),
    ],
)
def test_wrong_use_is_told_before_the_work(drive: Path, arguments: list[str], said: str) -> None:
    problem = fleet(drive, *arguments).exception
    assert isinstance(problem, UsageError)
    assert said in str(problem)


def test_a_picture_of_an_odd_kind(drive: Path, tmp_path: Path) -> None:
    problem = fleet(drive, "--method", "calibrated", "--picture", str(tmp_path / "figures.odd")).exception
    assert isinstance(problem, UsageError)
    assert ".png, .svg or .pdf" in str(problem)
