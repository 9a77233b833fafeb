"""The scenarios over a recording: how it is split, what is left out, and that counts add up."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fleet_bus.errors import RecordingError
from fleet_bus.messages import VehicleProfile, parse_profile
from fleet_lab.paper import runtime
from fleet_lab.paper.cells import NONE, Block
from fleet_lab.paper.formulas import PHI_P, Motion
from fleet_lab.paper.recorded_block import RecordedStudy
from fleet_lab.paper.recording import Laid, Recorded, even_steps, history_tracks, serve, split
from fleet_lab.paper.scenario_registration import Placement, widened_motion
from fleet_lab.profile_files import find_profile
from vehicle_agent.recording import Recording, load_recording

DART = Path(__file__).parents[2] / "data" / "recordings" / "fix_dart_free.npz"
PROFILE = runtime.profile("zonotope")


def driven(*lengths: int) -> Recording:
    """Segments of so many samples of a car on a circle, with other columns beside."""
    rows = sum(lengths)
    t = 0.01 * np.arange(float(rows))
    x = np.column_stack([t * 0 + 5.0, np.cos(t), np.sin(t), t + np.pi / 2])
    return Recording(
        t, x, np.column_stack([-np.sin(t), np.cos(t)]), np.repeat(np.arange(len(lengths)), lengths),
        ("battery", "x1", "x2", "yaw"), ("V", "m", "m", "rad"), ("v1", "v2"), ("m/s", "m/s"), "circles",
    )  # fmt: skip


def test_one_segment_is_split_and_the_longest_of_later_ones_is_tested() -> None:
    one = split(driven(1000), PROFILE)
    assert (one.history, one.tested) == ((slice(0, 400),), slice(400, 1000))
    assert one.recording.state_names == ("x1", "x2", "yaw")
    several = split(driven(900, 300, 500, 250, 500, 100), PROFILE)
    assert several.tested == slice(1950, 2450)
    assert several.history == (slice(0, 900), slice(900, 1200), slice(1200, 1700), slice(1700, 1950), slice(2450, 2550))


@pytest.mark.parametrize(
    ("lengths", "text"),
    [
        ((332,), "circles: 133 samples of history and 199 in"),
        ((199, 4000), "199 samples of history"),
        ((4000, 199), "199 in the longest other segment"),
    ],
)
def test_what_is_too_short_is_said_with_its_numbers(lengths: tuple[int, ...], text: str) -> None:
    with pytest.raises(RecordingError, match=text) as raised:
        split(driven(*lengths), PROFILE)
    assert "at least 200" in str(raised.value)
    assert split(driven(500), PROFILE).tested == slice(200, 500)


def without_roles() -> VehicleProfile:
    fields: dict[str, Any] = PROFILE.model_dump(mode="json", by_alias=True, exclude_none=True)
    del fields["roles"]
    return parse_profile(fields, "test")


def test_foreign_recordings_are_refused() -> None:
    with pytest.raises(RecordingError, match=r"names no roles\.position and roles\.heading"):
        split(driven(1000), without_roles())
    with pytest.raises(RecordingError, match="v_encoder"):
        split(driven(1000), find_profile("dart"))
    with pytest.raises(RecordingError, match="'cm', the profile says 'm'"):
        split(replace(driven(1000), state_units=("V", "cm", "m", "rad")), PROFILE)


def test_files_that_cannot_be_read_are_refused_at_once(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match=r"nowhere\.npz"):
        RecordedStudy(tmp_path / "nowhere.npz", PROFILE)
    (tmp_path / "text.npz").write_text("no archive", encoding="utf-8")
    with pytest.raises(RecordingError, match="cannot be read as NPZ"):
        RecordedStudy(tmp_path / "text.npz", PROFILE)


def uneven() -> Recording:
    """Pauses, a hurry and jitter."""
    interval = np.full(899, 0.01)
    interval[[50, 51, 300, 640]], interval[200] = 0.02, 0.004
    interval[100] *= 1.25
    return replace(driven(600, 300), t=np.concatenate([[0.0], np.cumsum(interval)]))


def test_uneven_intervals_are_no_transitions() -> None:
    recorded = split(uneven(), PROFILE)
    turn = Placement(np.pi / 2, (3.0, 4.0), 1.0, 1.0, 7, 8)
    tracks = history_tracks(recorded, turn)
    # The first interval is the first input's. 50 and 51 leave one sample alone between them.
    assert [len(track.t) for track in tracks] == [50, 149, 100, 299]
    for track in tracks:
        assert (np.abs(np.diff(track.t) - 0.01) < 0.003).all()
        before = (track.position[1:] - track.position[:-1]) / np.diff(track.t)[:, None]
        np.testing.assert_allclose(track.velocity[1:], before, atol=1e-9)
        # Radius 1 around where the placement takes the origin, and headings along the circle.
        out = track.position - [3.0, 4.0]
        np.testing.assert_allclose(np.hypot(*out.T), 1.0, atol=1e-12)
        np.testing.assert_allclose(np.cos(track.heading), -out[:, 1], atol=1e-9)
    assert sum(len(track.t) - 1 for track in tracks) == 599 - 1 - 4
    np.testing.assert_array_equal(np.flatnonzero(~even_steps(recorded.track)), [39])


def saved(recording: Recording, path: Path) -> Path:
    np.savez(
        path, t=recording.t, x=recording.x, u=recording.u, seg=recording.segment, name=recording.name,
        x_names=np.array(recording.state_names), x_units=np.array(recording.state_units),
        u_names=np.array(recording.input_names), u_units=np.array(recording.input_units),
    )  # fmt: skip
    return path


def test_the_steps_of_a_recorded_drive(tmp_path: Path) -> None:
    """Even ones, in the frame of the scenario, from positions that are known as well as the profile says."""
    study = RecordedStudy(saved(uneven(), tmp_path / "circles.npz"), PROFILE)
    turn = Placement(np.pi / 2, (3.0, 4.0), 1.0, 1.0, 10, 110)
    drive = study.drive(Laid("phi_p", PHI_P, turn))
    assert len(drive.truth) == 98
    np.testing.assert_allclose(np.hypot(*(drive.truth - [3.0, 4.0]).T), 1.0, atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(drive.truth - drive.at.last, axis=1), 0.01, atol=0.0025)
    # T(x) may begin anywhere in the measurement noise: 1 mm in x and y.
    np.testing.assert_allclose(np.abs(drive.at.unknown).sum(axis=1), 0.001)
    assert drive.at.t[0] == pytest.approx(0.01)


def test_the_input_of_a_track_is_the_velocity_before(study_recording: Recorded) -> None:
    track, rows = study_recording.track, study_recording.tested
    t, x = study_recording.recording.t[rows], study_recording.recording.x[rows]
    np.testing.assert_array_equal(track.t, t[1:])
    np.testing.assert_array_equal(track.position, x[1:, :2])
    np.testing.assert_array_equal(track.heading, x[1:, 2])
    np.testing.assert_allclose(track.velocity * np.diff(t)[:, None], np.diff(x[:, :2], axis=0))


@pytest.fixture(scope="module")
def short(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """7 s of the first and 3.4 s of the second drive of DART."""
    whole, rows = load_recording(DART), np.r_[0:700, 3000:3340]
    part = replace(whole, t=whole.t[rows], x=whole.x[rows], u=whole.u[rows], segment=whole.segment[rows])
    return saved(replace(part, name="short DART"), tmp_path_factory.mktemp("recording") / "dart.npz")


@pytest.fixture(scope="module")
def recorded_study(short: Path) -> RecordedStudy:
    return RecordedStudy(short, find_profile("dart"))


@pytest.fixture(scope="module")
def study_recording(recorded_study: RecordedStudy) -> Recorded:
    return recorded_study.recorded


@pytest.fixture(scope="module")
def told() -> list[float]:
    return []


@pytest.fixture(scope="module")
def block(recorded_study: RecordedStudy, told: list[float]) -> Block:
    return recorded_study.block(told.append)


@pytest.mark.usefixtures("block")
def test_recorded_drives_satisfy_what_is_laid_over_them(recorded_study: RecordedStudy) -> None:
    laid = {found.key: found for found in recorded_study.laid}
    assert list(laid) == ["phi_p", "phi_theta", "phi_r"]
    # In 1.1 s the car does not cross a roundabout of any size.
    assert laid["phi_r"].formula is None
    assert laid["phi_r"].missing
    for key in ("phi_p", "phi_theta"):
        formula, placement = laid[key].formula, laid[key].placement
        assert formula is not None
        assert placement is not None
        track = placement.track(recorded_study.recorded.track)
        assert formula.clearance(track.t, track.position).min() >= 0.0
        assert (formula.motion is not None) == (key == "phi_theta")
    assert laid["phi_p"].placement is laid["phi_theta"].placement


def test_the_tables_over_a_recording(block: Block, recorded_study: RecordedStudy) -> None:
    assert block.key == "recording"
    assert "short DART" in block.title
    assert [cell.formula for cell in block.cells] == [NONE, *["phi_p"] * 4, *["phi_theta"] * 4]
    uncut = block.cells[0].area
    assert uncut == pytest.approx(9.72, abs=0.05)
    for cell in block.cells:
        assert cell.outside == 0
        assert cell.printed is None
        assert cell.area is not None
    for published, ours in ((block.cells[1:3], block.cells[3:5]), (block.cells[5:7], block.cells[7:9])):
        assert ours[0].algorithm_2 == published[0].area
        for cell in ours:
            assert cell.area is not None
            assert published[0].area is not None
            assert cell.area <= published[0].area
    placed = {row["formula"]: row for row in block.extra["placed"]}
    assert placed["phi_p"] == {"formula": "phi_p", "size": pytest.approx(1.0), "stretch": 0.08}
    assert placed["phi_theta"]["turn"] >= 20.0
    assert placed["phi_r"]["left_out"]
    assert [laid.key for laid in recorded_study.laid] == ["phi_p", "phi_theta", "phi_r"]


def test_what_the_server_makes_of_a_recording_adds_up(block: Block, told: list[float]) -> None:
    served = block.extra["served"]
    # T(x) is about one step ahead.
    assert [(row["formula"], row["step"]) for row in served] == [("phi_p", 1), ("phi_p", 10), ("phi_theta", 1)]
    for row in served:
        updates = sum(row["labels"].values())
        assert set(row["labels"]) <= {"calibrated", "not calibrated", "uncovered"}
        assert row["checked"] == updates - row["step"]
        assert updates <= 320
        assert updates > 200
        assert 0.9 * row["checked"] <= row["inside"] <= row["inside_free"] <= row["checked"]
        assert 0.0 < row["area"] <= row["area_free"] * (1 + 1e-9)
    assert served[0]["area"] < 0.1 * served[1]["area"]
    assert told == sorted(told)
    assert 0.0 < told[0] < told[-1] <= 1.0


@pytest.mark.usefixtures("block")
def test_the_server_sees_the_heading_that_the_scenario_speaks_about(recorded_study: RecordedStudy) -> None:
    """A narrow T(x) that the drive never leaves cuts the sets; in any other direction it would exclude them."""
    recorded, found = recorded_study.recorded, recorded_study.laid[1]
    assert found.placement is not None
    assert found.formula is not None
    assert abs(np.sin(found.placement.angle)) > 0.5
    placement = replace(found.placement, end=found.placement.begin + 100)
    narrow = widened_motion(Motion(0.2, np.radians(1)), placement.track(recorded.track), recorded.noise)
    assert narrow is not None
    laid = Laid("narrow", replace(found.formula, motion=narrow), placement)
    (served,) = serve(recorded, laid, lambda part: None)
    assert served.checked > 50
    assert served.inside >= 0.9 * served.checked
    assert served.area < 0.95 * served.area_free
