"""What a server says of itself once a second: counters and gauges."""

from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import islice
from typing import Final

from fleet_bus.histogram import Histogram
from fleet_bus.messages import EventKind, Label, ServiceStatus
from fleet_bus.messages.methods import TUBE_METHODS
from reach_server.engine.results import Checks
from reach_server.service.fleet import Fleet
from reach_server.service.load import Load

#: Vehicles that a status names at most, in each of its lists, and problems.
MOST_NAMED: Final = 100
MOST_PROBLEMS: Final = 32
#: Bounds of the histograms: seconds from the arrival of a sample to its tube, and samples of a round.
LATENCIES: Final = (0.001, 0.0025, 0.005, 0.01, 0.02, 0.03, 0.05, 0.075, 0.1, 0.15, 0.25, 0.5, 1.0, 2.5, 5.0, 10.0)
BATCHES: Final = (1, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 2000, 5000, 10_000, 50_000)


@dataclass(slots=True)
class Tally:
    """Samples that were stored, and repeated by caches; tubes and events that were published, and events that were
    withheld, being too many of a kind; rounds that failed; and how long (s) the newest rounds took: the computation
    alone, and until all was published.

    ``by_label`` and ``by_kind`` divide tubes and events; they have all their keys from the beginning, so that another
    thread may look through them. ``round_ns`` is when the newest round was over (Unix ns), or the start.
    """

    stored: int = 0
    repeated: int = 0
    tubes: int = 0
    events: int = 0
    withheld: int = 0
    failures: int = 0
    compute: deque[float] = field(default_factory=lambda: deque(maxlen=1000))
    latencies: deque[float] = field(default_factory=lambda: deque(maxlen=10_000))
    round_ns: int = 0
    checks: Checks = field(default_factory=Checks)
    by_label: dict[tuple[Label, str], int] = field(
        default_factory=lambda: {(label, method): 0 for label in Label for method in TUBE_METHODS}
    )
    by_kind: dict[EventKind, int] = field(default_factory=lambda: dict.fromkeys(EventKind, 0))
    tube_latency: Histogram = field(default_factory=lambda: Histogram(LATENCIES))
    batch: Histogram = field(default_factory=lambda: Histogram(BATCHES))


@dataclass(frozen=True, slots=True)
class FleetGauges:
    """Vehicles ``known``, ``waiting`` for a tube, and by the label of their ``newest`` one; classes (``engines``);
    clocks that are off, and the greatest offset (s); and how many ``problems`` an operator should look at."""

    known: int
    waiting: int
    engines: int
    newest: Mapping[Label, int]
    clocks_off: int
    clock_offset: float
    problems: int


@dataclass(frozen=True, slots=True)
class Counters:
    """All that a server has counted: its tally, gauges of the fleet, ``seconds`` by stage, ``refused`` messages by
    reason, ``states`` that came and that are still ``queued``, and how far it is ``behind`` (s)."""

    tally: Tally
    fleet: FleetGauges
    seconds: Mapping[str, float]
    refused: Mapping[str, int]
    states: int
    queued: int
    behind: float


def service_status(
    instance: str,
    started: int,
    now: int,
    *,
    tally: Tally,
    fleet: Fleet,
    load: Load,
    states: int,
    refused: Mapping[str, int],
    waiting: Mapping[str, str],
    problems: Sequence[str],
    chain: Mapping[str, str],
) -> ServiceStatus:
    """The status of a server that ``started`` (Unix ns), at ``now`` (Unix ns).

    ``states`` counts the samples that came, ``refused`` messages by reason, ``waiting`` says why vehicles have
    no tube, ``problems`` what else an operator should look at, ``chain`` where its journal is.
    """
    filled = [count for engine in fleet.engines for count in engine.window_filled().tolist()]
    clocks = sorted(fleet.clock_offsets().items(), key=lambda item: -abs(item[1][0]))[:MOST_NAMED]
    return ServiceStatus(
        kind="reach", instance=instance, t=now, started=started,
        counters={
            "states": states, "stored": tally.stored, "repeated": tally.repeated, "tubes": tally.tubes,
            "events": tally.events, "events_withheld": tally.withheld, "failures": tally.failures,
        },
        gauges={
            "vehicles": float(len(filled)), "waiting": float(len(waiting)),
            "window_least": float(min(filled, default=0)),
            "compute_p50": _quantile(tally.compute, 0.5), "compute_p99": _quantile(tally.compute, 0.99),
            "tick_p50": _quantile(tally.latencies, 0.5), "tick_p99": _quantile(tally.latencies, 0.99),
            "behind": load.behind, "known": float(len(fleet.vehicles)),
        },
        refused=dict(refused),
        waiting={vehicle: why[:200] for vehicle, why in islice(sorted(waiting.items()), MOST_NAMED)},
        clock_offsets={vehicle: offset for vehicle, (offset, _) in clocks},
        clock_spreads={vehicle: spread for vehicle, (_, spread) in clocks},
        problems=[*problems, *([load.message] if load.late else [])][:MOST_PROBLEMS],
        chain=dict(chain),
    )  # fmt: skip


def _quantile(values: deque[float], q: float) -> float:
    ordered = sorted(values)
    return ordered[min(len(ordered) - 1, int(q * len(ordered)))] if ordered else 0.0
