"""``fleet evaluate``: how often sets hold, and how large they are, on recordings."""

from pathlib import Path
from typing import Annotated

import typer

from fleet_bus.errors import UsageError
from fleet_cli import completion
from fleet_lab.files import check_picture, check_writable, write_json


def evaluate(
    recordings: Annotated[list[Path], typer.Argument(help="Recordings (NPZ) to test on.")],
    profile: Annotated[str, typer.Option(help="Shipped profile or profile file.", autocompletion=completion.profiles)],
    train: Annotated[
        list[Path] | None, typer.Option(help="Recordings to train on, else the first part of each.")
    ] = None,
    train_runs: Annotated[
        str | None,
        typer.Option(help="Runs to train on: even, odd, first:0.6, last:0.4, slow:0.5, fast:0.5, or 0-9,12."),
    ] = None,
    test_runs: Annotated[str | None, typer.Option(help="Runs to test on, else all that do not train.")] = None,
    run_seconds: Annotated[
        float | None, typer.Option(help="Cut longer segments into runs of this many seconds.", min=0.1, max=1e6)
    ] = None,
    method: Annotated[
        list[str] | None, typer.Option(help="Methods to set side by side.", autocompletion=completion.methods)
    ] = None,
    horizon: Annotated[int | None, typer.Option(help="Steps, instead of the profile's.")] = None,
    inputs: Annotated[str, typer.Option(help="recorded, limits, rate or learned.")] = "recorded",
    frozen: Annotated[bool, typer.Option("--frozen", help="Learn nothing from tested samples.")] = False,
    json_file: Annotated[Path | None, typer.Option("--json", help="Write the figures here; '-' for stdout.")] = None,
    picture: Annotated[
        Path | None, typer.Option(help="Draw coverage and area by step, and coverage over time (PNG, SVG or PDF).")
    ] = None,
) -> None:
    """Coverage, area and time of the engine over recordings, method beside method."""
    from fleet_cli import reports
    from fleet_lab import evaluation
    from fleet_lab.profile_files import find_profile
    from vehicle_agent.recording import load_recording

    if inputs not in evaluation.INPUTS:
        raise UsageError(f"--inputs {inputs!r} is unknown: choose one of {', '.join(evaluation.INPUTS)}")
    if horizon is not None and not 1 <= horizon <= 200:
        raise UsageError(f"--horizon {horizon} must lie between 1 and 200")
    check_writable("--json", json_file)
    check_picture("--picture", picture)
    chosen = find_profile(profile)
    loaded = [load_recording(path) for path in recordings]
    training = [load_recording(path) for path in train or []]
    trials = evaluation.plan_trials(
        loaded, chosen, training=training, train_runs=train_runs, test_runs=test_runs, run_seconds=run_seconds
    )
    settings = evaluation.Settings(tuple(dict.fromkeys(method or ["paper", "default"])), horizon, inputs, frozen)
    with reports.progress() as tell:
        figures = evaluation.evaluate(trials, chosen, settings, tell)
    document = evaluation.as_json(figures, [str(path) for path in recordings], chosen, horizon or chosen.horizon)
    names = [path.name for path in recordings]
    if str(json_file) != "-":
        reports.print_evaluation(figures, chosen, names)
    write_json(document, json_file)
    if picture is not None:
        from fleet_lab.evaluation.picture import draw_evaluation

        draw_evaluation(figures, names, chosen, picture)
        if str(json_file) != "-":
            print(f"picture: {picture}")
