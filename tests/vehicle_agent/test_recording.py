"""Recordings: what is read, selected and refused."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fleet_bus.errors import RecordingError
from fleet_bus.messages import VehicleProfile, parse_profile
from vehicle_agent.recording import Recording, load_recording

DATA = Path(__file__).parents[1] / "data" / "recordings"


def archive(**changes: Any) -> dict[str, Any]:
    arrays: dict[str, Any] = {
        "t": np.array([0.0, 0.1, 0.0, 0.2]),
        "x": np.arange(8.0).reshape(4, 2),
        "u": np.array([[1.0], [np.nan], [2.0], [np.nan]]),
        "seg": np.array([0, 0, 1, 1]),
        "x_names": np.array(["x", "yaw"]),
        "x_units": np.array(["m", "rad"]),
        "u_names": np.array(["steering"]),
        "u_units": np.array(["rad"]),
    }
    return {key: value for key, value in {**arrays, **changes}.items() if value is not None}


def write(path: Path, **changes: Any) -> Path:
    np.savez(path, **archive(**changes))
    return path


def profile_of(states: dict[str, Any], inputs: dict[str, Any]) -> VehicleProfile:
    fields = {"class": "car", "state": states, "inputs": inputs, "sample_time": 0.1, "future_inputs": "plan"}
    return parse_profile(fields)


@pytest.mark.parametrize(
    ("name", "rows", "segments", "states"),
    [
        ("fix_f1tenth_koopman", 4961, 41, ("x", "y", "yaw", "v")),
        ("fix_dart_free", 5999, 2, ("x", "y", "yaw", "v_encoder")),
        ("fix_upenn_pf", 2339, 2, ("x", "y", "yaw", "vx")),
    ],
)
def test_real_recordings_are_read(name: str, rows: int, segments: int, states: tuple[str, ...]) -> None:
    recording = load_recording(DATA / f"{name}.npz")
    assert recording.x.shape == (rows, 4)
    assert len(recording.segments()) == segments
    assert recording.state_names == states
    assert "github.com" in recording.source


def test_arrays_are_read_only_and_segments_found(tmp_path: Path) -> None:
    recording = load_recording(write(tmp_path / "r.npz"))
    assert recording.name == "r"
    assert recording.segments() == (slice(0, 2), slice(2, 4))
    with pytest.raises(ValueError, match="read-only"):
        recording.x[0, 0] = 1.0


def test_select_puts_columns_in_the_order_of_the_profile(tmp_path: Path) -> None:
    recording = load_recording(write(tmp_path / "r.npz"))
    selected = recording.select(profile_of({"yaw": "rad", "x": "m"}, {}))
    np.testing.assert_array_equal(selected.x, recording.x[:, ::-1])
    assert selected.u.shape == (4, 0)
    assert selected.state_units == ("rad", "m")


def test_spellings_of_one_unit_are_one_unit(tmp_path: Path) -> None:
    """What is written is kept as it is; only other units are refused."""
    recording = load_recording(write(tmp_path / "r.npz", x_units=np.array(["m/s2", "rad/s"])))
    selected = recording.select(profile_of({"x": "m/s^2", "yaw": "rad s^-1"}, {"steering": "radians"}))
    assert (selected.state_units, selected.input_units) == (("m/s2", "rad/s"), ("rad",))
    with pytest.raises(RecordingError, match="'x' is in 'm/s2', the profile says 'm/s'"):
        recording.select(profile_of({"x": "m/s"}, {}))


T = 0.05 * np.arange(40)
WELL: dict[str, Any] = {
    "t": T, "x": np.column_stack([T, T**2, 0.1 * T, np.ones(40)]), "u": np.ones((40, 1)), "seg": np.zeros(40, int),
    "x_names": np.array(["x", "y", "yaw", "v"]), "x_units": np.array(["m", "m", "rad", "m/s"]),
}  # fmt: skip


@pytest.mark.parametrize(
    "changes",
    [
        {"x": np.asfortranarray(WELL["x"])},
        {"t": T.astype(">f8"), "x": WELL["x"].astype(">f4"), "seg": np.zeros(40, ">i2")},
        {"u": np.full((40, 1), np.nan)},
        {"u": np.zeros((40, 0)), "u_names": np.zeros(0, "U1"), "u_units": np.zeros(0, "U1")},
        {"u": np.zeros((40, 0)), "u_names": np.array([]), "u_units": np.array([])},
        {"t": 1.7e9 + T},
        {"t": (1.7e18 + 1e9 * T).astype(np.int64)},
    ],
    ids=["fortran", "big endian", "inputs not known", "no inputs", "no inputs, no texts", "epoch", "integers"],
)
def test_arrays_of_other_programs_are_read_as_what_they_are(tmp_path: Path, changes: dict[str, Any]) -> None:
    recording = load_recording(write(tmp_path / "r.npz", **{**WELL, **changes}))
    np.testing.assert_array_equal(recording.t, np.asarray(changes.get("t", T), dtype=np.float64))
    np.testing.assert_array_equal(recording.x, np.asarray(changes.get("x", WELL["x"]), dtype=np.float64))
    assert recording.t.dtype.isnative
    assert recording.x.flags["C_CONTIGUOUS"]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"t": (1.7e9 + T).astype(np.float32)}, "within one segment; it must increase"),
        ({"t": np.r_[T[:9], T[8], T[10:]]}, "at row 9, within one segment"),
        ({"t": np.r_[T[:20], T[20:] - 1]}, "at row 20, within one segment"),
        ({"x": np.where(np.arange(40)[:, None] == 7, np.nan, WELL["x"])}, "row 7 holds NaN"),
        ({"x": WELL["x"].astype(object)}, "cannot be read as NPZ"),
        ({"t": np.datetime64("2026-01-01") + (1e9 * T).astype("timedelta64[ns]")}, "t holds datetime64"),
        ({"seg": np.r_[np.zeros(15, int), np.ones(10, int), np.zeros(15, int)]}, "do not stand together"),
    ],
    ids=["float32 epoch", "duplicate stamp", "step back", "nan state", "objects", "datetime64", "segments apart"],
)
def test_arrays_that_cannot_be_a_drive_are_refused_in_words(
    tmp_path: Path, changes: dict[str, Any], message: str
) -> None:
    with pytest.raises(RecordingError, match=message):
        load_recording(write(tmp_path / "r.npz", **{**WELL, **changes}))


@pytest.mark.parametrize(
    ("states", "inputs", "message"),
    [
        ({"x": "m", "speed": "m/s"}, {}, r"no state column \['speed'\]; there are \['x', 'yaw'\]"),
        ({"x": "m"}, {"gas": "%"}, r"no input column \['gas'\]; there are \['steering'\]"),
        ({"x": "cm"}, {}, "'x' is in 'm', the profile says 'cm'"),
        ({"x": "m"}, {"steering": "deg"}, "'steering' is in 'rad', the profile says 'deg'"),
    ],
)
def test_select_refuses(tmp_path: Path, states: dict[str, str], inputs: dict[str, str], message: str) -> None:
    recording = load_recording(write(tmp_path / "r.npz"))
    with pytest.raises(RecordingError, match=message):
        recording.select(profile_of(states, inputs))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"u": None}, "lacks u; it holds t, x, seg"),
        ({"t": np.array([0.0, 0.1, 0.2])}, "x has shape"),
        ({"t": np.zeros((4, 1))}, "t has shape"),
        ({"x": np.zeros((4, 3))}, "x has shape"),
        ({"u": np.zeros((3, 1))}, "u has shape"),
        ({"seg": np.array([0, 0])}, "segment has shape"),
        ({"seg": np.array([0.0, 0, 1, 1])}, "segment holds float64"),
        ({"x": np.array([["a", "b"]] * 4)}, "x holds <U1"),
        ({"x": np.full((4, 2), np.nan)}, "row 0 holds NaN"),
        ({"t": np.array([0, 1, 0, np.inf])}, "row 3 holds NaN or an infinity"),
        ({"u": np.array([[0], [np.inf], [0], [0]])}, "row 1 holds an infinite input"),
        ({"t": np.array([0.0, 0.0, 1.0, 2.0])}, "t goes from 0.0 to 0.0 s at row 1"),
        ({"seg": np.array([0, 1, 0, 2])}, "do not stand together"),
        ({"x_units": np.array(["m"])}, "2 state names but 1 units"),
        ({"x_names": np.array(["x", "x"])}, "are not unique"),
        ({"x_names": np.array([1, 2])}, "x_names must be a list of texts"),
        ({"x": np.array([[{}, {}]] * 4, dtype=object)}, "cannot be read as NPZ"),
        (
            {"t": np.zeros(0), "x": np.zeros((0, 2)), "u": np.zeros((0, 1)), "seg": np.zeros(0, int)},
            "t has shape",
        ),
    ],
)
def test_unsound_archives_are_refused(tmp_path: Path, changes: dict[str, Any], message: str) -> None:
    with pytest.raises(RecordingError, match=message):
        load_recording(write(tmp_path / "r.npz", **changes))


def test_other_files_are_refused(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match=r"\.bag is not read; recordings come as \.npz"):
        load_recording(tmp_path / "drive.bag")
    with pytest.raises(RecordingError, match="no suffix is not read"):
        load_recording(tmp_path / "drive")
    with pytest.raises(RecordingError, match="cannot be read"):
        load_recording(tmp_path / "missing.npz")
    (tmp_path / "text.npz").write_text("t,x\n0,1\n")
    with pytest.raises(RecordingError, match="cannot be read"):
        load_recording(tmp_path / "text.npz")
    (tmp_path / "cut.npz").write_bytes(write(tmp_path / "r.npz").read_bytes()[:300])
    with pytest.raises(RecordingError, match="cannot be read"):
        load_recording(tmp_path / "cut.npz")
    with (tmp_path / "one.npz").open("wb") as file:
        np.save(file, np.zeros(3))
    with pytest.raises(RecordingError, match="holds one array"):
        load_recording(tmp_path / "one.npz")


def test_a_recording_does_not_change_with_the_array_it_was_made_of() -> None:
    x = np.zeros((2, 1))
    recording = Recording(np.arange(2.0), x, np.zeros((2, 0)), np.zeros(2, int), ("x",), ("m",), (), ())
    x[:] = 7.0
    assert not recording.x.any()
