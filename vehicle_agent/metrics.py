"""What vehicle agents have to say to Prometheus."""

from collections import Counter
from collections.abc import Iterator, Sequence

from prometheus_client.metrics_core import Metric

from fleet_bus.metrics import counter, gauge
from vehicle_agent.agent import REASONS, Agent


def metrics(agents: Sequence[Agent]) -> Iterator[Metric]:
    """All metrics of the agents of one process, taken together: no label names a vehicle."""
    reports = [agent.report for agent in agents]
    skipped: Counter[str] = Counter(dict.fromkeys(REASONS, 0))
    for report in reports:
        skipped.update(report.skipped)
    yield gauge("fleet_agent_vehicles", "Vehicles of this process.", len(reports))
    yield counter("fleet_agent_published", "States published.", sum(report.published for report in reports))
    yield counter("fleet_agent_skipped", "Readings that were not published.", skipped, "reason")
    yield counter(
        "fleet_agent_filter_restarts", "Times that a filter lost its vehicle.", sum(r.restarts for r in reports)
    )
