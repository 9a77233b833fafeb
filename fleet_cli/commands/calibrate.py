"""``fleet calibrate``: a profile from recordings."""

from pathlib import Path
from typing import Annotated

import typer

from fleet_bus.errors import UsageError
from fleet_cli import completion
from fleet_lab.files import check_writable, make_folder, write_json, write_text


def calibrate(
    recordings: Annotated[list[Path], typer.Argument(help="Recordings (NPZ) of one class of vehicles.")],
    profile: Annotated[
        str | None,
        typer.Option(
            help="Profile to complete, else columns and roles are guessed from their names.",
            autocompletion=completion.profiles,
        ),
    ] = None,
    output: Annotated[Path | None, typer.Option("-o", "--output", help="Write the profile (YAML) here.")] = None,
    report: Annotated[Path | None, typer.Option(help="Folder for report.md, report.json and pictures.")] = None,
    method: Annotated[
        list[str] | None, typer.Option(help="Methods to try on the runs held out.", autocompletion=completion.methods)
    ] = None,
    train_runs: Annotated[
        str | None, typer.Option(help="Runs to fit to when others are held out: even, first:0.6, 0-9,12 …")
    ] = None,
    run_seconds: Annotated[
        float | None, typer.Option(help="Cut longer segments into runs of this many seconds.", min=0.1, max=1e6)
    ] = None,
    json_file: Annotated[Path | None, typer.Option("--json", help="Write what was found here; '-' for stdout.")] = None,
) -> None:
    """A profile from recordings: timing, delay, noise and slopes, and how often its sets hold on runs held out."""
    from fleet_cli import reports
    from fleet_lab import identification as calibration
    from fleet_lab.identification import report as reporting
    from fleet_lab.profile_files import profile_fields
    from vehicle_agent.recording import load_recording

    for option, path in (("-o", output), ("--json", json_file)):
        check_writable(option, path)
    if report is not None:
        make_folder("--report", report)
    given = {} if profile is None else profile_fields(profile)
    loaded = [load_recording(path) for path in recordings]
    methods = tuple(dict.fromkeys(method or ["calibrated", "set_membership"]))
    request = calibration.Request(loaded, given, recordings[0].stem, methods, train_runs, run_seconds)
    names = [path.name for path in recordings]
    try:
        with reports.progress() as tell:
            found = calibration.calibrate(request, tell)
    except calibration.CalibrationError as error:
        left = _leave_draft(calibration.draft_as_yaml(error, names), output, json_file)
        raise UsageError(f"{error}; {left}") from None
    text = calibration.as_yaml(found, names)
    quiet = str(json_file) == "-"
    if not quiet:
        reports.print_evaluation(found.held_out.figures, found.held_out.profile, names)
        for line in reporting.summary(found):
            print(line)
    if output is not None:
        write_text("-o", output, text)
        if not quiet:
            print(f"profile: {output}")
    elif not quiet:
        print(f"\n{text}", end="")
    document = reporting.as_document(found, [str(path) for path in recordings])
    write_json(document, json_file)
    if report is not None:
        reporting.write_report(found, names, document, report)
        if not quiet:
            print(f"report: {report / 'report.md'}")


def _leave_draft(text: str, output: Path | None, json_file: Path | None) -> str:
    """Write what is known of a profile, and say where: into the file asked for, beside it where there is one already,
    to stdout where none is asked for."""
    again = "correct it, and calibrate again with --profile"
    if output is None:
        if str(json_file) == "-":
            return "-o FILE keeps a draft of the profile"
        print(text, end="")
        return f"above is a draft of the profile: {again}"
    place = output.with_name(f"{output.stem}.draft{output.suffix}") if output.exists() else output
    write_text("-o", place, text)
    return f"a draft of the profile is in {place}: {again} {place}"
