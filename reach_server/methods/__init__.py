"""Ways to compute sets from data, by name."""

from fleet_bus.errors import UsageError
from fleet_bus.messages import VehicleProfile
from fleet_bus.messages.methods import METHODS
from reach_server.methods.bounded import Bounded
from reach_server.methods.conformal import Conformal
from reach_server.methods.linear import Linear
from reach_server.methods.method import Forecast, Method
from reach_server.windows import Window

__all__ = ["METHODS", "Forecast", "Method", "method_of"]


def method_of(
    name: str | None, profile: VehicleProfile, window: Window, horizon: int, *, planned: bool
) -> tuple[str, Method]:
    """The method of that name, or the profile's, and what it is called.

    ``default`` is ``set_membership`` where every bound is given, else ``calibrated``. Raises ``UsageError`` for an
    unknown name, and for a profile that the method cannot work with.
    """
    wanted = name or profile.method
    if wanted == "default":
        wanted = "set_membership" if profile.guaranteed else "calibrated"
    if wanted == "calibrated":
        return wanted, Conformal(profile, window, horizon, planned=planned)
    if wanted == "lti":
        return wanted, Linear(profile, window, horizon)
    if wanted in METHODS:
        return wanted, Bounded(profile, wanted, window, horizon)
    raise UsageError(f"method {wanted!r} is unknown: choose one of default, {', '.join(METHODS)}")
