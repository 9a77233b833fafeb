"""Starting vehicle agents from what the command line says."""

import threading
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path

import zenoh

from fleet_bus import Role, keys, open_session
from fleet_bus.errors import FleetError, UsageError
from fleet_bus.messages import VehicleProfile
from fleet_bus.sessions import why_not_connected
from fleet_cli import logs
from fleet_cli.commands.shared import prometheus_endpoint
from vehicle_agent.agent import Agent, Report, run
from vehicle_agent.filters import Filter, PassThrough, filter_for
from vehicle_agent.recording import load_recording
from vehicle_agent.route import load_route
from vehicle_agent.sources import RecordingSource, SimulatedSource, Source

#: Seconds after which agents without a router say so; they go on trying.
PATIENCE = 5.0
#: What an agent needs besides its session.
AgentPlan = tuple[str, VehicleProfile, Source, Filter]


def simulated(vehicle: str, profile: VehicleProfile, route: str, seed: int, history: int) -> AgentPlan:
    """A simulated vehicle on a shipped route or a route file."""
    plan_steps = profile.horizon - 1 if profile.future_inputs == "plan" else 0
    # What looks like a file is one.
    chosen = Path(route) if "/" in route or route.endswith((".yaml", ".yml")) else route
    source = SimulatedSource(load_route(chosen), seed, history, plan_steps=plan_steps)
    return vehicle, profile, source, filter_for(profile)


def recorded(vehicle: str, profile: VehicleProfile, path: Path) -> AgentPlan:
    """A recording as a vehicle; its states are published as they were recorded."""
    return vehicle, profile, RecordingSource(load_recording(path).select(profile)), PassThrough()


def vehicle_names(files: Sequence[Path], base: str | None) -> list[str]:
    """One id per file: ``base``, counted on for several files, else the file's own name."""
    if base is not None:
        names = [base] if len(files) == 1 else [f"{base}{i + 1}" for i in range(len(files))]
    else:
        names = [path.stem for path in files]
    if len(set(names)) != len(names):
        raise UsageError(f"two recordings would be vehicle {names}: name them with --as")
    return [keys.check_id(name) for name in names]


def work(
    plans: Sequence[AgentPlan],
    routers: Sequence[str],
    stop: threading.Event,
    *,
    speed: float = 1.0,
    duration: float | None = None,
    linger: float = 0.0,
    metrics: str | None = None,
) -> dict[str, Report]:
    """Run agents on one session until stopped, their sources end or ``duration`` seconds have passed; answer
    Prometheus at the address ``metrics`` until then."""
    timer = threading.Timer(duration, stop.set) if duration is not None else None
    with ExitStack() as opened:
        session = opened.enter_context(open_session(Role.AGENT, routers, stop=stop))
        agents = [opened.enter_context(Agent(session, *plan)) for plan in plans]
        opened.enter_context(prometheus_endpoint(metrics, "agent", "", "vehicle_agent.metrics", agents))
        logs.say(f"agents ready: {', '.join(agent.vehicle for agent in agents)}")
        threading.Thread(target=_tell_if_alone, args=(session, routers, stop), daemon=True).start()
        if timer is not None:
            timer.daemon = True
            timer.start()
        reports = run(agents, stop, speed)
        stop.wait(linger)
    if timer is not None:
        timer.cancel()
    return reports


def _tell_if_alone(session: zenoh.Session, routers: Sequence[str], stop: threading.Event) -> None:
    """Say once why there is no router yet; agents would wait for one in silence."""
    if not stop.wait(PATIENCE) and not session.is_closed():
        try:
            why = why_not_connected(session, routers)
        except FleetError as error:
            why = str(error)
        except zenoh.ZError:
            # It was closed in this moment.
            return
        if why is not None:
            logs.warn(f"not connected yet, still trying: {why}")
