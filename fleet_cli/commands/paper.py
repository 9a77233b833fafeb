"""The command ``fleet paper``."""

import sys
from pathlib import Path
from typing import Annotated

import typer

from fleet_bus.errors import UsageError
from fleet_lab.files import check_writable, make_folder, write_json

#: The recording that is taken when none is named, in a checkout of the project, and its profile.
_RECORDING = Path(__file__).parents[2] / "tests" / "data" / "recordings" / "fix_dart_free.npz"
_PROFILE = "dart"


def paper(
    output: Annotated[Path, typer.Option("-o", "--output", help="Folder for the report and the figures.")] = Path(
        "paper"
    ),
    recording: Annotated[
        Path | None, typer.Option(help="Recording (NPZ) to lay the scenarios over, else the DART one of the project.")
    ] = None,
    profile: Annotated[str | None, typer.Option(help="Profile of --recording.")] = None,
    simulated_only: Annotated[bool, typer.Option("--simulated-only", help="Leave the recording out.")] = False,
    seed: Annotated[int, typer.Option(help="Seed of the simulated drives.", min=0, max=10**6)] = 0,
    json_file: Annotated[Path | None, typer.Option("--json", help="Write the figures here; '-' for stdout.")] = None,
) -> None:
    """Tables I and II and the figures of the paper, on simulated drives and over a recording.

    What is finished is written at once; interrupted, the report says what is missing. Exit code 1: a state was outside
    of a set that must hold it, or a set of ours larger than Algorithm 2's.
    """
    if (recording is None) != (profile is None):
        raise UsageError("--recording and --profile go together: a recording does not say what its columns mean")
    if simulated_only and recording is not None:
        raise UsageError("--simulated-only leaves out what --recording names: give one of them")
    make_folder("-o", output)
    check_writable("--json", json_file)
    from fleet_lab.paper import run
    from fleet_lab.paper.recorded_block import RecordedStudy
    from fleet_lab.profile_files import find_profile

    path = recording or _RECORDING
    recorded, missing = None, "left out: --simulated-only"
    if not simulated_only and recording is None and not path.is_file():
        missing = "left out: the project's recordings are not installed; name one with --recording and --profile"
    elif not simulated_only:
        recorded = RecordedStudy(path, find_profile(profile or _PROFILE))
    quiet = str(json_file) == "-"
    outcome = run.run(output, seed, recorded, missing, quiet=quiet)
    write_json(outcome.document, json_file)
    if not quiet:
        outcome.print()
        print(f"report: {output / 'report.md'}")
    if outcome.interrupted:
        print("interrupted: what was finished is in the report, which says what is missing", file=sys.stderr)
        raise typer.Exit(130)
    if outcome.failures:
        raise typer.Exit(1)
