"""What cannot be meant is said before any work, by the name of the option, in words."""

import signal
from collections.abc import Iterator
from pathlib import Path

import pytest
from typer._click.exceptions import BadParameter

from fleet_bus.errors import FleetError, UsageError, in_words
from fleet_bus.messages import load_profile
from fleet_cli.agents import simulated
from fleet_lab.files import check_picture
from fleet_lab.profile_files import profile_fields
from tests.docs.test_docs import ROOT, commands
from vehicle_agent import svea
from vehicle_agent.recording import load_recording

RECORDING = str(ROOT / "tests" / "data" / "recordings" / "fix_dart_free.npz")


@pytest.fixture(autouse=True)
def _signals() -> Iterator[None]:
    """Commands set handlers of their own."""
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


def refusal(*arguments: str) -> str:
    """What is said of a command that is refused."""
    with pytest.raises((UsageError, BadParameter)) as caught:
        commands()["fleet"].main(list(arguments), standalone_mode=False)
    error = caught.value
    return error.format_message() if isinstance(error, BadParameter) else str(error)


@pytest.mark.parametrize(
    ("arguments", "option", "said"),
    [
        (["router", "--port", "99999"], "--port", "65535"),
        (["router", "--port", "-1"], "--port", "0"),
        (["demo", "--port", "99999"], "--port", "65535"),
        (["demo", "--seed", "-1"], "--seed", "0"),
        (["demo", "--duration", "inf"], "--duration", "86400"),
        (["demo", "--picture", "demo.xyz"], "--picture", ".svg"),
        (["agent", "--vehicle", "a", "--seed", "-1"], "--seed", "0"),
        (["agent", "--vehicle", "a", "--history", "-5"], "--history", "0"),
        (["agent", "--vehicle", "a", "--duration", "-1"], "--duration", "0"),
        (["agent", "--vehicle", "a", "--duration", "nan"], "--duration", "0"),
        (["agent", "--vehicle", "a", "--speed", "0"], "--speed", "positive"),
        (["agent", "--vehicle", "a", "--speed", "nan"], "--speed", "positive"),
        (["agent", "--vehicle", "a", "--vehicle", "a"], "--vehicle", "once"),
        (["replay", RECORDING, "--profile", "dart", "--speed", "inf"], "--speed", "positive"),
        (["replay", RECORDING, "--profile", "dart", "--linger", "-1"], "--linger", "0"),
        (["evaluate", RECORDING, "--profile", "dart", "--picture", "x.xyz"], "--picture", ".png"),
        (["evaluate", RECORDING, "--profile", "dart", "--picture", "/none/x.png"], "--picture", "no folder /none"),
        (["scenario", "show", "parking-lot", "-o", "/none/x.png"], "-o", "no folder /none"),
        (["scenario", "show", "parking-lot", "-o", "x.xyz"], "-o", ".pdf"),
        (["scenario", "list", "--json", "/none/x.json"], "--json", "no folder /none"),
        (["scenario", "check", "parking-lot", "--json", "/none/x.json"], "--json", "no folder /none"),
    ],
)  # fmt: skip
def test_a_range_or_an_output_is_named(
    arguments: list[str], option: str, said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    message = refusal(*arguments)
    assert option in message
    assert said in message
    # Nothing was done.
    assert capsys.readouterr().out == ""


def test_files_that_cannot_be_read_are_told_of_in_words(tmp_path: Path) -> None:
    (tmp_path / "text.npz").write_text("hello\n", encoding="utf-8")
    (tmp_path / "cut.npz").write_bytes(Path(RECORDING).read_bytes()[:2000])
    (tmp_path / "bytes.yaml").write_bytes(b"\x83\xff\x00")
    folder = str(tmp_path)

    def said(read: object, *arguments: object) -> str:
        assert callable(read)
        with pytest.raises(FleetError) as caught:
            read(*arguments)
        message = str(caught.value)
        assert "Errno" not in message
        assert "pickle" not in message
        return message

    assert said(load_recording, tmp_path / "none.npz").endswith(
        "none.npz: cannot be read as NPZ: no such file or directory"
    )
    for name in ("text.npz", "cut.npz"):
        assert said(load_recording, tmp_path / name).endswith("it is another kind of file, or cut off")
    for read in (load_profile, lambda path: profile_fields(str(path))):
        assert said(read, tmp_path / "bytes.yaml").endswith("it is not UTF-8 text")
        assert said(read, Path(folder)).endswith("is a directory")

    def drive(route: str) -> object:
        return simulated("a", svea.profile(), route, 1, 0)

    assert said(drive, f"{folder}/bytes.yaml").endswith("it is not UTF-8 text")
    assert said(drive, f"{folder}/none.yaml").endswith("no such file or directory")
    assert "parking-lot" in said(drive, "nowhere")


def test_a_route_may_be_a_file(tmp_path: Path) -> None:
    shipped = ROOT / "vehicle_agent" / "routes" / "roundabout.yaml"
    own = tmp_path / "mine.yaml"
    own.write_text(shipped.read_text(encoding="utf-8"), encoding="utf-8")
    vehicle, _, _, _ = simulated("a", svea.profile(), str(own), 1, 0)
    assert vehicle == "a"


def test_pictures_have_a_format_and_a_folder(tmp_path: Path) -> None:
    check_picture("--picture", None)
    check_picture("--picture", tmp_path / "x.SVG")
    for path in (tmp_path / "x", tmp_path / "x.jpeg", tmp_path / "none" / "x.png"):
        with pytest.raises(UsageError, match="--picture"):
            check_picture("--picture", path)


def test_errors_in_words() -> None:
    assert in_words(FileNotFoundError(2, "No such file or directory", "x")) == "no such file or directory"
    assert in_words(ValueError("odd")) == "odd"
