"""What the shell completes the values of options to."""

from collections.abc import Iterable


def methods(incomplete: str) -> list[str]:
    """Names of methods."""
    from fleet_bus.messages.methods import METHODS

    return _beginning(("default", *METHODS), incomplete)


def profiles(incomplete: str) -> list[str]:
    """Names of shipped profiles."""
    from fleet_lab.profile_files import shipped

    return _beginning(shipped(), incomplete)


def scenarios(incomplete: str) -> list[str]:
    """Names of shipped scenarios."""
    from side_info.documents.scenario import shipped

    return _beginning(shipped(), incomplete)


def demo_scenarios(incomplete: str) -> list[str]:
    """Names of the scenarios of the demo."""
    from fleet_cli.demo import ROUTES

    return _beginning(ROUTES, incomplete)


def routes(incomplete: str) -> list[str]:
    """Names of shipped routes."""
    from vehicle_agent.route import route_names

    return _beginning(route_names(), incomplete)


def event_kinds(incomplete: str) -> list[str]:
    """Kinds of events."""
    from fleet_bus.messages import EventKind

    return _beginning(EventKind, incomplete)


def watch_orders(incomplete: str) -> list[str]:
    """Orders of ``fleet watch``."""
    from fleet_view import SORTS

    return _beginning(SORTS, incomplete)


def top_orders(incomplete: str) -> list[str]:
    """Orders of ``fleet top``."""
    from fleet_cli.top import SORTS

    return _beginning(SORTS, incomplete)


def _beginning(names: Iterable[str], incomplete: str) -> list[str]:
    return [str(name) for name in names if name.startswith(incomplete)]
