"""``fleet side-info``: the service that publishes scenarios."""

from typing import Annotated

import typer

from fleet_bus.errors import UsageError
from fleet_cli import completion, logs
from fleet_cli.commands.shared import DEFAULT_ROUTERS, Metrics, Routers, prometheus_endpoint, stop_on_signals


def side_info(
    scenarios: Annotated[
        list[str] | None,
        typer.Argument(help="Shipped scenarios or scenario files.", autocompletion=completion.scenarios),
    ] = None,
    assign: Annotated[
        list[str] | None, typer.Option(help="VEHICLE=SCENARIO; '*' stands for every vehicle that is seen.")
    ] = None,
    id: Annotated[str, typer.Option(help="Id of this service.")] = "side-info-1",
    clock_offset: Annotated[float, typer.Option(help="Bound on the difference of clocks, s.", min=0, max=3600)] = 0.0,
    router: Routers = DEFAULT_ROUTERS,
    metrics: Metrics = None,
) -> None:
    """Publish scenarios and assign vehicles to them. Without --assign every vehicle gets the first scenario.

    Scenario files are watched: a changed one is published once its version is raised and it checks. Without a scenario
    nothing is published but that the service is there.
    """
    from fleet_bus import Role, open_session
    from side_info.documents.scenario import Scenario
    from side_info.service import watching
    from side_info.service.service import EVERY_VEHICLE, SideInfoService

    stop = stop_on_signals()
    names = scenarios or []
    loaded = [Scenario.load(name) for name in names]
    pairs = _pairs(assign or []) if assign or not loaded else {EVERY_VEHICLE: loaded[0].name}
    files = watching.files(names, loaded)
    if not loaded:
        logs.warn("no scenario is named, so none is published")
    with open_session(Role.SERVICE, router, stop=stop) as session:
        service = SideInfoService(session, loaded, pairs, id, files=files, clock_offset=clock_offset)
        with prometheus_endpoint(metrics, "side-info", id, "side_info.service.metrics", lambda: service.newest_status):
            logs.say(f"side-info publishes {', '.join(s.name for s in loaded) or 'no scenario'}")
            service.run(stop)


def _pairs(texts: list[str]) -> dict[str, str]:
    pairs: dict[str, str] = {}
    for vehicle, scenario in map(_pair, texts):
        if pairs.setdefault(vehicle, scenario) != scenario:
            raise UsageError(
                f"--assign: {vehicle} is assigned twice ({pairs[vehicle]}, {scenario}); one service gives a vehicle "
                "one scenario, start a second fleet side-info --id …"
            )
    return pairs


def _pair(text: str) -> tuple[str, str]:
    vehicle, separator, scenario = text.partition("=")
    if not (vehicle and separator and scenario):
        raise UsageError(f"--assign {text!r}: write VEHICLE=SCENARIO, such as svea1=parking-lot or '*=parking-lot'")
    return vehicle, scenario
