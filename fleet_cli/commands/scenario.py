"""``fleet scenario list|check|show``: documents, without a bus."""

from pathlib import Path
from typing import Annotated

import typer

from fleet_bus.errors import ScenarioError
from fleet_cli import completion
from fleet_lab.files import check_picture, check_writable, write_json

SampleTime = Annotated[
    float | None, typer.Option("--sample-time", help="Of the vehicles' samples, s.", min=1e-4, max=60.0)
]


def scenario_list(
    json_file: Annotated[Path | None, typer.Option("--json", help="Write the list here; '-' for stdout.")] = None,
) -> None:
    """Name the scenarios that ship with the project, and what each is about."""
    from fleet_cli.scenario_files import describe
    from side_info.documents.scenario import Scenario, shipped

    check_writable("--json", json_file)
    found = {name: describe(Scenario.load(name)) for name in shipped()}
    if str(json_file) != "-":
        width = max(map(len, found), default=0)
        for name, text in found.items():
            print(f"{name:<{width}}  {text}")
    write_json([{"scenario": name, "description": text} for name, text in found.items()], json_file)


def scenario_check(
    scenarios: Annotated[
        list[str], typer.Argument(help="Shipped scenarios or scenario files.", autocompletion=completion.scenarios)
    ],
    profile: Annotated[
        str | None, typer.Option(help="Profile whose states the scenario must fit.", autocompletion=completion.profiles)
    ] = None,
    sample_time: SampleTime = None,
    json_file: Annotated[Path | None, typer.Option("--json", help="Write what was found here; '-' for stdout.")] = None,
) -> None:
    """Check scenario documents; exit code 2 names the errors with their places, warnings do not change it."""
    from fleet_cli import scenario_files
    from fleet_lab.profile_files import find_profile

    check_writable("--json", json_file)
    chosen = find_profile(profile) if profile is not None else None
    checked, errors = scenario_files.check(scenarios, chosen, sample_time)
    if str(json_file) != "-":
        for one in checked:
            print(f"{one.scenario.name} v{one.scenario.version}: {scenario_files.summarize(one.scenario)}")
            for finding in one.findings:
                print(f"  {scenario_files.place(one, finding)}: warning: {finding.message}")
    write_json(scenario_files.as_json(checked, errors), json_file)
    if errors:
        raise ScenarioError("\n".join(map(str, errors)))


def scenario_show(
    scenario: Annotated[
        str, typer.Argument(help="Shipped scenario or scenario file.", autocompletion=completion.scenarios)
    ],
    sample_time: Annotated[float, typer.Option(help="Of the vehicles' samples, s.", min=1e-4, max=60.0)] = 0.05,
    output: Annotated[Path | None, typer.Option("-o", "--output", help="Draw it here (PNG, SVG or PDF).")] = None,
) -> None:
    """Say what a scenario asks for and when; draw its regions, and when it asks for which predicate."""
    from fleet_cli import scenario_files
    from fleet_cli.scenario_activity import activity
    from fleet_cli.scenario_report import print_scenario

    check_picture("-o", output)
    checked, errors = scenario_files.check([scenario], None, sample_time)
    if errors:
        raise errors[0]
    found = activity(checked[0].scenario, sample_time)
    print_scenario(checked[0], found)
    if output is not None:
        from fleet_cli.scenario_picture import draw_scenario

        draw_scenario(checked[0].scenario, found, output)
        print(f"picture: {output}")
