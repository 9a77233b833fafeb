"""Methods to compute reachable sets from data, by name."""

from fleet_bus.messages import VehicleProfile
from fleet_bus.messages.methods import METHODS
from reach_server.audit.labels import Claim
from reach_server.data.window import Window

# Each registers the methods that it holds.
from reach_server.methods import conformal, lti, set_membership  # noqa: F401
from reach_server.methods.base import Forecast, Method
from reach_server.methods.registry import Setup, find, register

__all__ = ["METHODS", "Claim", "Forecast", "Method", "Setup", "method_of", "register"]


def method_of(
    name: str | None, profile: VehicleProfile, window: Window, horizon: int, *, planned: bool
) -> tuple[str, Method, Claim]:
    """The name, the method and the claim of its sets: of that name, or of the one in the profile.

    ``default`` is ``set_membership`` where every bound is given, else ``calibrated``. Raises ``UsageError`` for an
    unknown name, and for a profile that the method cannot work with.
    """
    wanted = name or profile.method
    if wanted == "default":
        wanted = "set_membership" if profile.guaranteed else "calibrated"
    entry = find(wanted)
    return wanted, entry.build(Setup(profile, window, horizon, planned)), entry.claim
