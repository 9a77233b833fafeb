"""fleet calibrate: from a recording to a profile that loads, with a report of held-out coverage."""

import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import typer
import yaml
from typer.testing import CliRunner, Result

from fleet_bus.errors import FleetError, ProfileError, RecordingError, UsageError
from fleet_bus.messages import load_profile, parse_profile
from fleet_cli.main import app
from fleet_lab.evaluation.text import number
from fleet_lab.identification import Calibration, CalibrationError, Request, as_yaml, calibrate
from fleet_lab.identification.report import as_markdown
from fleet_lab.profile_files import profile_fields
from tests.fleet_lab.wavy import wavy, write
from vehicle_agent.recording import Recording

SHORT = {"horizon": 2, "confidence": 0.9}


def quiet(name: str, done: int, total: int) -> None:
    assert 0 <= done <= total, name


def calibrated(**given: object) -> Calibration:
    return calibrate(Request([wavy(600, delay=2)], {**SHORT, **given}, "wavy"), quiet)


@pytest.fixture(scope="module")
def found() -> Calibration:
    return calibrated()


@pytest.mark.slow
def test_a_recording_is_enough(found: Calibration) -> None:
    profile = found.profile
    assert (profile.sample_time, profile.frame, profile.future_inputs) == (0.05, "body", "learned")
    assert 2 <= profile.input_lags <= 3
    assert (profile.horizon, profile.confidence, profile.window) == (2, 0.9, 300)
    assert not profile.guaranteed
    for part in (profile.noise.process, profile.noise.measurement, profile.lipschitz):
        assert part is not None
        assert part.origin == "calibrated"
    assert profile.inputs["steering"].limits is not None


def test_it_tells_how_the_sets_do_on_what_was_held_out(found: Calibration) -> None:
    held = found.held_out
    assert held.trained + held.tested == 600
    assert held.margins[-1].inside >= 0.9 * held.margins[-1].checked
    assert set(held.figures) == {"calibrated", "set_membership"}
    for method in held.figures.values():
        assert method.steps[0].inside > 0.7 * method.steps[0].checked > 70
    # Bounds of the held-out check are those of the training runs.
    assert (
        held.profile.noise.process != found.profile.noise.process or held.profile.lipschitz != found.profile.lipschitz
    )


@pytest.mark.slow
def test_the_text_loads_to_the_profile(found: Calibration, tmp_path: Path) -> None:
    path = tmp_path / "wavy.yaml"
    path.write_text(as_yaml(found, ["wavy.npz"]), encoding="utf-8")
    assert load_profile(path) == found.profile
    text = path.read_text(encoding="utf-8")
    assert "# Calibrated from wavy.npz." in text
    assert "sample_time: 50 ms  # estimated: median interval 50 ms" in text


def test_the_fitted_bounds_hold_on_what_they_were_fitted_to(found: Calibration) -> None:
    assert found.bounds is not None
    assert (found.bounds.lower <= found.bounds.upper).all()
    assert (found.bounds.widened(1.0) == found.bounds.process).all()
    assert (found.bounds.widened(2.0) >= found.bounds.process + found.bounds.measured - 1e-15).all()


@pytest.mark.slow
def test_what_is_stated_stays_and_what_was_fitted_is_fitted_anew() -> None:
    measurement = {"box": [0.01, 0.01, 0.01, 0.05], "origin": "given"}
    process = {"box": [9.0, 9.0, 9.0, 9.0], "origin": "calibrated"}
    again = calibrated(noise={"measurement": measurement, "process": process}, input_lags=1, tolerance=0.2)
    profile = again.profile
    assert profile.noise.measurement is not None
    assert profile.noise.process is not None
    assert profile.noise.measurement.box == measurement["box"]
    assert profile.noise.process.matrix().max() < 9.0
    assert (profile.input_lags, profile.tolerance) == (1, 0.2)
    origins = {choice.field: choice.origin for choice in again.choices}
    assert origins["input_lags"] == "given"
    assert origins["noise.process"] == "estimated"
    assert "noise.measurement" not in origins


def test_a_plain_profile_without_roles() -> None:
    plain = calibrated(state={"x": "m", "y": "m"}, inputs={}, roles={}).profile
    assert (plain.frame, plain.input_lags, plain.state_names) == ("world", 0, ("x", "y"))


@pytest.mark.parametrize(
    ("samples", "given", "error", "said"),
    [
        (100, {}, RecordingError, "at least 200"),
        (300, {"sample_time": 0.5}, RecordingError, "median is 50 ms"),
        (300, {"sample_time": "soon"}, ProfileError, "sample_time"),
        (300, {"state": {"z": "m"}}, FleetError, "no state column"),
        (300, {"state": {"x": "ft"}, "roles": {}}, FleetError, "'ft'"),
        (300, {"horizon": "long"}, ProfileError, "horizon"),
        (300, {"input_lags": 32, "window": 399}, RecordingError, "coefficients"),
    ],
)
def test_what_cannot_be_is_told(samples: int, given: dict[str, object], error: type[Exception], said: str) -> None:
    with pytest.raises(error, match=said):
        calibrate(Request([wavy(samples)], given, "wavy"), quiet)


@pytest.fixture(scope="module")
def irregular() -> Recording:
    """Intervals of 40 to 60 ms, every fourth of 140 to 200 ms."""
    rng = np.random.default_rng(4)
    rows = 1200
    long = rng.choice([0.14, 0.15, 0.2], rows)
    steps = np.where(rng.random(rows) < 0.25, long, rng.choice([0.04, 0.05, 0.05, 0.06], rows))
    t = np.round(np.cumsum(steps), 2)
    steering, speed = 0.3 * np.sin(0.4 * t), 1 + 0.3 * np.sin(0.2 * t)
    yaw = np.cumsum(steps * speed * np.tan(steering) / 0.32)
    place = np.column_stack([np.cumsum(steps * speed * np.cos(yaw)), np.cumsum(steps * speed * np.sin(yaw))])
    return Recording(
        t, np.column_stack([place, yaw, speed]), np.column_stack([steering, speed]), np.zeros(rows, np.int64),
        ("x", "y", "yaw", "v"), ("m", "m", "rad", "m/s"), ("steering", "velocity"), ("rad", "m/s"), "log",
    )  # fmt: skip


@pytest.mark.slow
def test_irregular_stamps_are_told_with_true_counts_and_options_that_there_are(irregular: Recording) -> None:
    with pytest.raises(CalibrationError, match="too irregular") as refused:
        calibrate(Request([irregular], {}, "log"), quiet)
    text = str(refused.value)
    profile = parse_profile(refused.value.fields)
    off = int((np.abs(np.diff(irregular.t) / profile.sample_time - 1) > profile.tolerance).sum())
    assert f"{off} of 1199 are more than {100 * profile.tolerance:g} % off 50 ms" in text
    assert all(int(number) <= 1200 for number in re.findall(r"\d+", text))
    assert "…" not in text
    command: Any = typer.main.get_command(app)
    options = {name for option in command.commands["calibrate"].params for name in option.opts}
    assert set(re.findall(r"--[a-z-]+", text)) <= options


def bad_recordings() -> dict[str, tuple[Recording, str]]:
    """Recordings of which no calibration can be made, and what is said of them."""
    one = wavy(300)
    degrees = one.x.copy()
    degrees[:, 2] = np.rad2deg(degrees[:, 2])
    return {
        "ms": (replace(one, t=1e3 * one.t), "divide t by 1e3"),
        "ns": (replace(one, t=1.7e18 + 1e9 * one.t), "divide t by 1e9"),
        "deg": (replace(one, x=degrees, state_units=("m", "m", "deg", "m/s")), "np.deg2rad"),
        "no rad": (replace(one, x=degrees), "np.deg2rad"),
        "short": (wavy(150), "at least 200 are needed"),
    }


@pytest.mark.parametrize("name", bad_recordings())
@pytest.mark.slow
def test_where_no_calibration_can_be_made_a_draft_of_the_profile_is_left(name: str, tmp_path: Path) -> None:
    recording, said = bad_recordings()[name]
    drive, output = write(recording, tmp_path / "log.npz"), tmp_path / "log.yaml"
    done = fleet(str(drive), "-o", str(output))
    assert isinstance(done.exception, UsageError)
    assert said in str(done.exception)
    assert f"a draft of the profile is in {output}: correct it, and calibrate again with --profile" in str(
        done.exception
    )
    text = output.read_text(encoding="utf-8")
    assert said.split()[-1] in text
    fields = profile_fields(str(output))
    # All but what the stamps of a recording that is not to be trusted in other respects would tell.
    profile = parse_profile({"sample_time": 0.05, **fields})
    assert profile.sample_time == 0.05
    assert profile.state["yaw"].angle
    assert (profile.roles.position, profile.roles.heading, profile.roles.speed) == (("x", "y"), "yaw", "v")
    # The recording once corrected, the draft is what calibration goes on from.
    sound = calibrate(Request([wavy(600)], {**SHORT, **fields, "horizon": 2}, "log", ("calibrated",)), quiet)
    assert sound.profile.frame == "body"


def test_a_draft_overwrites_no_profile(tmp_path: Path) -> None:
    drive, output = write(wavy(150), tmp_path / "log.npz"), tmp_path / "log.yaml"
    output.write_text("class: mine\n", encoding="utf-8")
    done = fleet(str(drive), "--profile", str(output), "-o", str(output))
    assert f"a draft of the profile is in {tmp_path / 'log.draft.yaml'}" in str(done.exception)
    assert output.read_text(encoding="utf-8") == "class: mine\n"
    assert profile_fields(str(tmp_path / "log.draft.yaml"))["class"] == "mine"


def test_without_an_output_a_draft_is_printed(tmp_path: Path) -> None:
    drive = str(write(wavy(150), tmp_path / "log.npz"))
    done = fleet(drive)
    assert "above is a draft of the profile" in str(done.exception)
    assert yaml.safe_load(done.stdout)["class"] == "log"
    quietly = fleet(drive, "--json", "-")
    assert quietly.stdout == ""
    assert "-o FILE keeps a draft" in str(quietly.exception)


def test_a_given_profile_that_cannot_be_leaves_no_draft(tmp_path: Path) -> None:
    drive, given, output = write(wavy(300), tmp_path / "a.npz"), tmp_path / "given.yaml", tmp_path / "out.yaml"
    given.write_text("horizon: long\n", encoding="utf-8")
    assert isinstance(fleet(str(drive), "--profile", str(given), "-o", str(output)).exception, ProfileError)
    assert not output.exists()


def test_progress_in_a_pipe_is_plain_lines_on_stderr(tmp_path: Path) -> None:
    drive = str(write(wavy(400), tmp_path / "wavy.npz"))
    short = tmp_path / "short.yaml"
    short.write_text("horizon: 1\nconfidence: 0.9\n", encoding="utf-8")
    done = fleet(drive, "--profile", str(short), "--method", "calibrated", "--json", "-")
    lines = done.stderr.splitlines()
    for name in ("timing", "measurement noise", "delay of the inputs", "margin 1", "calibrated"):
        told = [
            int(line.removeprefix(f"{name}: ").removesuffix(" %")) for line in lines if line.startswith(f"{name}: ")
        ]
        assert told == sorted(set(told))
        assert told[-1] == 100
    json.loads(done.stdout)


def test_rates_below_the_stated_one_and_both_areas_are_in_the_report(found: Calibration) -> None:
    held = found.held_out
    low = [
        name for name, method in held.figures.items()
        if any(s.inside < 0.9 * s.checked for s in method.steps)
        or any(i < 0.9 * c for run in method.runs for c, i in zip(run.checked, run.inside, strict=True))
    ]  # fmt: skip
    assert low
    for name in low:
        assert any(text.startswith(f"{name}: ") and "90 %" in text for text in found.warnings)
    page = as_markdown(found, ["wavy.npz"], ())
    assert "| mean area m² | median area m² |" in page
    step = held.figures["calibrated"].steps[0]
    assert f"| {number(step.area_mean)} | {number(step.area_median)} |" in page


def test_an_unknown_method_is_told() -> None:
    with pytest.raises(UsageError, match="magic"):
        calibrate(Request([wavy(300)], SHORT, "wavy", ("magic",)), quiet)


def fleet(*arguments: str) -> Result:
    return CliRunner().invoke(app, ["calibrate", *arguments])


@pytest.mark.slow
def test_the_command_writes_a_profile_and_a_report(tmp_path: Path) -> None:
    drive = write(wavy(600), tmp_path / "wavy.npz")
    short = tmp_path / "short.yaml"
    short.write_text("class: mine\nhorizon: 2\nconfidence: 0.9\n", encoding="utf-8")
    output, report = tmp_path / "mine.yaml", tmp_path / "report"
    done = fleet(
        str(drive), "--profile", str(short), "-o", str(output), "--report", str(report), "--method", "calibrated"
    )
    assert done.exit_code == 0, done.output
    for words in ("held out, calibrated: step 1", "input_lags: ", f"profile: {output}", "report.md"):
        assert words in done.stdout
    assert load_profile(output).vehicle_class == "mine"
    page = (report / "report.md").read_text(encoding="utf-8")
    for words in ("# Calibration of class mine", "## Measurement noise", "### calibrated, by run", "coverage.png"):
        assert words in page
    document = json.loads((report / "report.json").read_text(encoding="utf-8"))
    assert parse_profile(document["profile"]) == load_profile(output)
    assert document["held_out"]["methods"]["calibrated"]["steps"][0]["checked"] > 0
    assert all((report / name).stat().st_size > 10_000 for name in ("coverage.png", "estimates.png"))


@pytest.mark.slow
def test_without_an_output_the_profile_is_printed(tmp_path: Path) -> None:
    drive = write(wavy(400), tmp_path / "wavy.npz")
    short = tmp_path / "short.yaml"
    short.write_text("horizon: 1\nconfidence: 0.9\n", encoding="utf-8")
    done = fleet(str(drive), "--profile", str(short), "--method", "calibrated")
    assert "\n# Calibrated from wavy.npz.\n" in done.stdout
    document = json.loads(fleet(str(drive), "--profile", str(short), "--method", "calibrated", "--json", "-").stdout)
    assert document["profile"]["class"] == "wavy"


def test_wrong_use_is_told_before_the_work(tmp_path: Path) -> None:
    drive = str(write(wavy(300), tmp_path / "wavy.npz"))
    blocked = tmp_path / "file"
    blocked.write_text("", encoding="utf-8")
    broken = tmp_path / "broken.yaml"
    broken.write_text("class: [", encoding="utf-8")
    listed = tmp_path / "list.yaml"
    listed.write_text("- 1\n", encoding="utf-8")
    for arguments, said in (
        ([drive, "-o", str(tmp_path / "nowhere" / "a.yaml")], "no folder"),
        ([drive, "--report", str(blocked / "report")], "cannot be made"),
        ([drive, "--json", str(tmp_path)], "cannot be written"),
        ([str(tmp_path / "none.npz")], "cannot be read"),
        ([drive, "--profile", "nowhere"], "neither a file"),
        ([drive, "--profile", str(broken)], "not YAML"),
        ([drive, "--profile", str(listed)], "a map is expected"),
    ):
        problem = fleet(*arguments).exception
        assert isinstance(problem, UsageError), arguments
        assert said in str(problem)


def test_a_column_that_is_not_finite_is_told(tmp_path: Path) -> None:
    one = wavy(300)
    x = one.x.copy()
    x[7, 2] = np.nan
    np.savez(
        tmp_path / "bad.npz", t=one.t, x=x, u=one.u, seg=one.segment, x_names=one.state_names,
        x_units=one.state_units, u_names=one.input_names, u_units=one.input_units,
    )  # fmt: skip
    assert "row 7 holds NaN" in str(fleet(str(tmp_path / "bad.npz")).exception)
