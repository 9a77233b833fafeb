"""``fleet record``, ``fleet replay FILE.mcap`` and ``fleet incident``: what they say, and their exit codes."""

import importlib
import json
import sys
import types
from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np
import pytest

from fleet_bus.errors import UsageError
from fleet_bus.messages import EventKind
from fleet_bus.pubsub import Received
from fleet_cli.commands import shared
from fleet_cli.commands.replay import is_mcap, parse_speed
from fleet_cli.main import main
from fleet_recorder.files import Folder
from fleet_recorder.reader import read
from tests.fleet_recorder.made import T0, event, profile, state, write


def arrays_of_a_vehicle(path: Path) -> Path:
    """A recording of what a vehicle measured."""
    np.savez(path, t=np.arange(3.0), x=np.zeros((3, 1)), u=np.zeros((3, 1)), seg=np.zeros(3, dtype=int))
    return path


def fleet(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], *words: str) -> tuple[int, str, str]:
    """Exit code, stdout and stderr of a command."""
    monkeypatch.setattr(sys, "argv", ["fleet", *words])
    with pytest.raises(SystemExit) as ended:
        main()
    output = capsys.readouterr()
    return int(ended.value.code or 0), output.out, output.err


@pytest.fixture
def drive(tmp_path: Path) -> Path:
    """A recording of 10 s with a contradiction in the middle."""
    messages = [profile(), *(state(n) for n in range(100)), event(EventKind.CONTRADICTION, T0 + 5 * 10**9)]
    folder = tmp_path / "drive"
    folder.mkdir()
    return write(folder, [*messages, *(state(n) for n in range(100, 200))])


def test_a_recording_of_the_bus_is_told_from_one_of_a_vehicle_by_its_content(drive: Path, tmp_path: Path) -> None:
    renamed = tmp_path / "drive.npz"
    renamed.write_bytes(drive.read_bytes())
    arrays = arrays_of_a_vehicle(tmp_path / "car.npz")
    assert is_mcap(drive)
    assert is_mcap(renamed)
    assert is_mcap(drive.parent)
    assert is_mcap(tmp_path / "missing.mcap")
    assert not is_mcap(arrays)
    assert not is_mcap(tmp_path / "missing.npz")


@pytest.mark.parametrize(("text", "speed"), [("1", 1.0), ("10", 10.0), ("0.5", 0.5), ("max", float("inf"))])
def test_a_speed_is_a_number_or_max(text: str, speed: float) -> None:
    assert parse_speed(text) == speed


@pytest.mark.parametrize("text", ["0", "-1", "inf", "nan", "fast", ""])
def test_what_is_no_speed_is_refused(text: str) -> None:
    with pytest.raises(UsageError, match="or max"):
        parse_speed(text)


def test_kinds_of_recordings_and_their_options_do_not_mix(
    drive: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    arrays = arrays_of_a_vehicle(tmp_path / "car.npz")
    for words, error in (
        ([str(drive), str(arrays)], "cannot be played together"),
        ([str(arrays)], "need --profile"),
        ([str(arrays), "--profile", "svea", "--speed", "max"], "vehicles need a number"),
        ([str(arrays), "--shift"], "(MCAP)"),
        ([str(arrays), "--verify"], "(MCAP)"),
        ([str(arrays), "--json", "-"], "(MCAP)"),
        ([str(drive), "--profile", "svea"], "(NPZ)"),
        ([str(drive), "--as", "b"], "(NPZ)"),
        ([str(drive), "--speed", "quick"], "--speed 'quick'"),
    ):
        code, _, errors = fleet(monkeypatch, capsys, "replay", *words)
        assert (code, error in errors) == (2, True), errors


class Report:
    def __init__(self, messages: Iterable[Received]) -> None:
        self.messages = list(messages)

    @property
    def equal(self) -> bool:
        return len(self.messages) == 202

    def lines(self) -> Iterator[str]:
        yield f"{len(self.messages)} messages compared"

    def json(self) -> dict[str, bool]:
        return {"equal": self.equal}


@pytest.mark.parametrize(("cut", "code"), [(0, 0), (2000, 1)])
def test_verify_gets_the_messages_and_decides_the_exit_code(
    cut: int, code: int, drive: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    stub = types.ModuleType("fleet_recorder.verify")
    stub.verify = Report  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "fleet_recorder.verify", stub)
    if cut:
        part = drive.with_name("part.mcap")
        write(drive.parent / "part", [state(0)]).rename(part)
        drive = part
    found, out, _ = fleet(monkeypatch, capsys, "replay", "--verify", str(drive))
    assert found == code
    assert "messages compared" in out
    found, out, _ = fleet(monkeypatch, capsys, "replay", "--verify", str(drive), "--json", "-")
    assert (found, json.loads(out)) == (code, {"equal": code == 0})


def test_an_incident_is_cut_and_said(
    drive: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "cut.mcap"
    words = ["--event", "contradiction", "--before", "1", "--after", "2", "-o", str(out)]
    code, said, _ = fleet(monkeypatch, capsys, "incident", str(drive.parent), *words)
    assert code == 0
    assert "contradiction of a: told" in said
    assert f"{out}: 61 messages and 1 that were in force, without a checkpoint" in said
    assert len(list(read(out))) == 62
    json_file = tmp_path / "cut.json"
    other = tmp_path / "other.mcap"
    code, _, _ = fleet(
        monkeypatch, capsys, "incident", str(drive), "--at", "5", "-o", str(other), "--json", str(json_file)
    )
    assert code == 0
    found = json.loads(json_file.read_text(encoding="utf-8"))
    assert found["at_ns"] == T0 + 5 * 10**9 + 1
    assert (found["path"], found["messages"]) == (str(other), 202)


def test_an_incident_is_named_after_its_instant(
    drive: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert fleet(monkeypatch, capsys, "incident", str(drive), "--at", str(T0))[0] == 0
    assert (tmp_path / f"incident-{T0}.mcap").is_file()


@pytest.mark.parametrize(
    ("words", "error"),
    [
        ([], "give the instant with --at, or the event with --event"),
        (["--at", "1", "--event", "miss"], "give the instant with --at, or the event with --event"),
        (["--at", "later"], "write an ISO time"),
        (["--event", "miss"], "no such event in the recording; there are: 1 contradiction"),
        (["--at", "1", "-o", "/proc/nowhere/cut.mcap"], "/proc/nowhere"),
    ],
)
def test_wrong_use_of_incident_is_said(
    words: list[str], error: str, drive: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    code, _, errors = fleet(monkeypatch, capsys, "incident", str(drive), *words)
    assert (code, error in errors) == (2, True), errors


@pytest.mark.parametrize(
    ("words", "error"),
    [
        (["--limit-gb", "0.3"], "at least two files of --rotate-mb 256"),
        (["--json", "/proc/nowhere/x"], "--json"),
        (["--id", "a b"], "service id"),
    ],
)
def test_wrong_use_of_record_is_said_before_a_router_is_looked_for(
    words: list[str], error: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["record", "-o", str(tmp_path / "out"), "--router", "tcp/127.0.0.1:1", *words]
    code, _, errors = fleet(monkeypatch, capsys, *words)
    assert (code, error in errors) == (2, True), errors


def test_a_folder_in_use_is_said(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    with Folder(tmp_path):
        code, _, errors = fleet(monkeypatch, capsys, "record", "-o", str(tmp_path))
    assert (code, "another recorder writes to" in errors) == (2, True), errors


@pytest.mark.parametrize("command", [["record", "-o", "x"], ["incident", "x", "--at", "1"], ["replay", "x.mcap"]])
def test_what_to_install_is_said(
    command: list[str], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    known = importlib.util.find_spec
    monkeypatch.setattr(shared, "find_spec", lambda name: None if name == "mcap" else known(name))
    code, _, errors = fleet(monkeypatch, capsys, *command)
    assert (code, "mcap is not installed: pip install 'fleet-reach[recorder]'" in errors) == (2, True), errors
