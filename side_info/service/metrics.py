"""What a side-info service has to say to Prometheus."""

from collections.abc import Callable, Iterator

from prometheus_client.metrics_core import Metric

from fleet_bus.codec import REASONS
from fleet_bus.messages import ServiceStatus
from fleet_bus.metrics import counter, gauge, refusals
from side_info.service.watching import REASONS as DOCUMENT_REASONS


def metrics(newest: Callable[[], ServiceStatus | None]) -> Iterator[Metric]:
    """All metrics of a service of which ``newest`` gives the status it published last; none before the first."""
    status = newest()
    if status is None:
        return
    count, now = status.counters, status.gauges
    yield counter("fleet_side_info_states", "States read of vehicles that take part in scenarios.", count["states"])
    yield counter("fleet_side_info_assignments", "Assignments published.", count["assignments"])
    yield counter("fleet_side_info_documents_published", "Scenario documents published.", count["documents_published"])
    yield refusals(status.refused, (*REASONS, *DOCUMENT_REASONS))
    yield gauge("fleet_side_info_scenarios", "Scenarios published.", now["scenarios"])
    yield gauge("fleet_side_info_vehicles", "Vehicles that take part in one.", now["vehicles"])
    yield gauge(
        "fleet_side_info_starts_not_seen", "Vehicles without one: their start was not seen.", now["starts_not_seen"]
    )
    yield gauge(
        "fleet_side_info_documents_behind",
        "Files that say something else than what is published.",
        now["documents_behind"],
    )
    yield gauge("fleet_side_info_status_timestamp_seconds", "When this was counted, Unix time.", status.t / 1e9)
