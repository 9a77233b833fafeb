"""``fleet replay``: recordings as live vehicles, or the recorded bus again."""

from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Final

import typer

from fleet_bus.errors import UsageError
from fleet_cli import completion, logs
from fleet_cli.commands.shared import DEFAULT_ROUTERS, Routers, check_speed, need, stop_on_signals

#: What an MCAP file begins with.
_MAGIC: Final = b"\x89MCAP0\r\n"


def replay(
    files: Annotated[
        list[Path], typer.Argument(help="Recordings: of fleet record (MCAP, or their folder), or of vehicles (NPZ).")
    ],
    profile: Annotated[
        str | None, typer.Option(help="NPZ: shipped profile or profile file.", autocompletion=completion.profiles)
    ] = None,
    speed: Annotated[str, typer.Option(help="How many times faster than recorded; MCAP: or max.")] = "1",
    as_: Annotated[str | None, typer.Option("--as", help="NPZ: vehicle id; several files count on from it.")] = None,
    everything: Annotated[
        bool, typer.Option("--everything", help="MCAP: also what servers made of it, for viewers where no server runs.")
    ] = False,
    shift: Annotated[
        bool, typer.Option("--shift", help="MCAP: move all stamps, so that the recording begins now.")
    ] = False,
    verify: Annotated[
        bool,
        typer.Option("--verify", help="MCAP: compute the tubes anew, without a bus, and compare with the recorded."),
    ] = False,
    json_file: Annotated[
        Path | None, typer.Option("--json", help="MCAP: write what was published, or found, here; '-' for stdout.")
    ] = None,
    linger: Annotated[float, typer.Option(help="Seconds to stay on the bus after the last sample.", min=0)] = 0.0,
    router: Routers = DEFAULT_ROUTERS,
) -> None:
    """Publish recordings again.

    Vehicles (NPZ) are published as agents would, stamped from now on. The recorded bus (MCAP) is published byte by
    byte: stamps are those of then, which a server answers with an event about the vehicles' clocks; --shift moves them.
    """
    kinds = {is_mcap(path) for path in files}
    if len(kinds) > 1:
        raise UsageError("vehicles (NPZ) and the recorded bus (MCAP) cannot be played together: give one kind of files")
    factor = parse_speed(speed)
    if kinds == {False}:
        if everything or shift or verify or json_file is not None:
            raise UsageError("--everything, --shift, --verify and --json are for recordings of `fleet record` (MCAP)")
        _replay_vehicles(files, profile, factor, as_, linger, router)
        return
    if profile is not None or as_ is not None:
        raise UsageError("--profile and --as are for recordings of vehicles (NPZ): an MCAP holds profiles and ids")
    need("recorder", "mcap", "zstandard")
    from fleet_cli import recording
    from fleet_lab.files import check_writable, write_json

    check_writable("--json", json_file)
    if verify:
        _verify(files, json_file)
        return
    report, reading = recording.play(
        files, router, stop_on_signals(), speed=factor, everything=everything, shift=shift, linger=linger
    )
    write_json(
        {
            "messages": reading.messages, "missing": reading.missing, "cut": [str(path) for path in reading.cut],
            **asdict(report),
        },
        json_file,
    )  # fmt: skip
    if str(json_file) == "-":
        return
    parts = [f"{count} {kind}" for kind, count in sorted(report.published.items())]
    logs.say(f"published {', '.join(parts) or 'nothing'} of {reading.messages} messages")
    for why, count in report.left_out.items():
        logs.say(f"left out {count}: {why}")
    if report.late > 1.0:
        logs.warn(f"up to {report.late:.1f} s behind what --speed {speed} asks for")


def is_mcap(path: Path) -> bool:
    """Whether a path is a recording of the bus: by its content, where it has any, else by its name."""
    if path.is_dir():
        return True
    try:
        with path.open("rb") as file:
            begin = file.read(len(_MAGIC))
    except OSError:
        begin = b""
    return begin == _MAGIC or path.suffix == ".mcap"


def parse_speed(text: str) -> float:
    """How many times faster, infinity for ``max``; raise ``UsageError`` for anything else."""
    if text == "max":
        return float("inf")
    try:
        speed = float(text)
    except ValueError:
        speed = 0.0
    if not 0 < speed < float("inf"):
        raise UsageError(f"--speed {text!r:.40}: write a positive number, such as 1 or 10, or max")
    return speed


def _replay_vehicles(
    files: list[Path], profile: str | None, speed: float, as_: str | None, linger: float, router: list[str]
) -> None:
    from fleet_cli.agents import recorded, vehicle_names, work
    from fleet_lab.profile_files import find_profile

    if profile is None:
        raise UsageError("recordings of vehicles (NPZ) need --profile")
    if speed == float("inf"):
        raise UsageError("--speed max is for recordings of `fleet record` (MCAP): vehicles need a number")
    check_speed(speed)
    stop = stop_on_signals()
    chosen = find_profile(profile)
    names = vehicle_names(files, as_)
    agents = [recorded(name, chosen, path) for name, path in zip(names, files, strict=True)]
    reports = work(agents, router, stop, speed=speed, linger=linger)
    for report in reports.values():
        skipped = ", ".join(f"{count} skipped: {reason}" for reason, count in report.skipped.items())
        print(f"{report.vehicle}: {report.published} samples published" + (f", {skipped}" if skipped else ""))


def _verify(files: list[Path], json_file: Path | None) -> None:
    """Compute the tubes of a recording anew and compare; raises ``typer.Exit`` with 1 where they differ."""
    from importlib import import_module

    from fleet_lab.files import write_json
    from fleet_recorder.reader import read

    try:
        verify = import_module("fleet_recorder.verify").verify
    except ModuleNotFoundError as error:
        raise UsageError(f"--verify cannot be had here: {error}") from None
    report = verify(read(files, warn=logs.warn))
    if str(json_file) != "-":
        for line in report.lines():
            logs.say(line)
    write_json(report.json(), json_file)
    if not report.equal:
        raise typer.Exit(1)
