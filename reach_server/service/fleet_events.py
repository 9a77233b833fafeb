"""What the fleet tells of vehicles: events with their texts."""

from fleet_bus import keys
from fleet_bus.messages import EventKind, VehicleProfile
from fleet_bus.writers import Source
from reach_server.data.events import EngineEvent
from reach_server.service.clock_offsets import CLOCK_BOUND
from reach_server.service.profile_changes import profile_changes
from reach_server.service.scenario_book import SERVICE_GONE, Contested


def two_sources(vehicle: str, t: int, first: Source, second: Source) -> EngineEvent:
    """Two sources write the states of a vehicle."""
    message = (
        f"two sources publish the states of {vehicle}: {first} and {second}; stop one of them. "
        "Tubes go on from the first and are contradicted until one has gone"
    )
    return EngineEvent(EventKind.TWO_SOURCES, vehicle, t, message, {"first": str(first), "second": str(second)})


def one_source(vehicle: str, t: int, left: Source) -> EngineEvent:
    """One of two sources is left."""
    message = f"one source is left that publishes the states of {vehicle}: {left}"
    return EngineEvent(EventKind.ONE_SOURCE, vehicle, t, message, {"source": str(left)})


def contested_scenario(vehicle: str, t: int, contest: Contested) -> EngineEvent:
    """Two services publish a scenario that a vehicle takes part in."""
    message = (
        f"scenario {contest.scenario} is published by {contest.first} and by {contest.second}: the first one's counts, "
        f"until it has been silent for {SERVICE_GONE:g} s; stop one of the two"
    )
    details = {"scenario": contest.scenario, "first": str(contest.first), "second": str(contest.second)}
    return EngineEvent(EventKind.TWO_SOURCES, vehicle, t, message, {**details})


def profile_changed(vehicle: str, t: int, before: VehicleProfile, after: VehicleProfile) -> EngineEvent:
    """Another profile is in force."""
    message = f"the profile of {vehicle} has changed, its window begins anew: {profile_changes(before, after)}"
    return EngineEvent(EventKind.PROFILE_CHANGED, vehicle, t, message)


def profile_missing(vehicle: str, t: int, writer: Source | None) -> EngineEvent:
    """Samples come without a profile; ``writer``: who sends them, where another session has sent one."""
    message = f"states of {vehicle} come, but no profile: publish it on {keys.profile(vehicle)}"
    if writer is not None:
        message = f"states of {vehicle} come from {writer}, its profile from another session: publish both from one"
    return EngineEvent(EventKind.UNKNOWN_VEHICLE, vehicle, t, message)


def clock(vehicle: str, t: int, offset: float, *, off: bool) -> EngineEvent:
    """A clock has left its bound, or is within it again; ``offset`` (s) is how far it is ahead, at least."""
    if not off:
        message = f"the clock of {vehicle} is within {CLOCK_BOUND:g} s of the server's again"
    elif offset > 0:
        message = f"the clock of {vehicle} is at least {offset:.3g} s ahead of the server's"
    else:
        message = f"the clock of {vehicle} is {-offset:.3g} s behind the server's, or its samples come that late"
    if off:
        message += f" (bound {CLOCK_BOUND:g} s): scenarios with a time of day do not cut it until that is mended"
    return EngineEvent(EventKind.CLOCK, vehicle, t, message, {"offset": offset})


def wrong_interval(vehicle: str, t: int, typical: float, stated: float) -> EngineEvent:
    """Samples come at another interval (s) than the profile says."""
    message = (
        f"samples of {vehicle} come every {typical:.4g} s, its profile says {stated:g} s: "
        "correct sample_time or the source"
    )
    return EngineEvent(EventKind.PROFILE_CONTRADICTED, vehicle, t, message)
