"""Starting vehicle agents from what the command line says."""

import threading
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path

from fleet_bus import Role, keys, open_session
from fleet_bus.errors import UsageError
from fleet_bus.messages import VehicleProfile
from vehicle_agent.agent import Agent, Report, run
from vehicle_agent.filters import Filter, PassThrough, filter_for
from vehicle_agent.recording import load_recording
from vehicle_agent.route import load_route
from vehicle_agent.sources import RecordingSource, SimulatedSource, Source

#: What an agent needs besides its session.
AgentPlan = tuple[str, VehicleProfile, Source, Filter]


def simulated(vehicle: str, profile: VehicleProfile, route: str, seed: int, history: int) -> AgentPlan:
    """A simulated vehicle on a shipped route or a route file."""
    plan_steps = profile.horizon - 1 if profile.future_inputs == "plan" else 0
    source = SimulatedSource(load_route(route), seed, history, plan_steps=plan_steps)
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
) -> dict[str, Report]:
    """Run agents on one session until stopped, their sources end or ``duration`` seconds have passed."""
    timer = threading.Timer(duration, stop.set) if duration is not None else None
    with ExitStack() as opened:
        session = opened.enter_context(open_session(Role.AGENT, routers))
        agents = [opened.enter_context(Agent(session, *plan)) for plan in plans]
        print(f"agents ready: {', '.join(agent.vehicle for agent in agents)}", flush=True)
        if timer is not None:
            timer.daemon = True
            timer.start()
        reports = run(agents, stop, speed)
        stop.wait(linger)
    if timer is not None:
        timer.cancel()
    return reports
