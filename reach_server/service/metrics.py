"""What a reach server has to say to Prometheus."""

from collections.abc import Callable, Iterator

from prometheus_client.metrics_core import Metric

from fleet_bus.codec import REASONS
from fleet_bus.metrics import counter, gauge, histogram, refusals
from reach_server.service.status import Counters


def metrics(read: Callable[[], Counters]) -> Iterator[Metric]:
    """All metrics of a server of which ``read`` gives the counters; no label names a vehicle, so their number does not
    grow with the fleet."""
    now = read()
    tally, fleet, checks = now.tally, now.fleet, now.tally.checks
    yield counter("fleet_reach_states", "State messages that came.", now.states)
    yield counter("fleet_reach_stored", "Samples stored in windows.", tally.stored)
    yield counter("fleet_reach_repeated", "Samples that caches repeated, known already.", tally.repeated)
    yield gauge("fleet_reach_queued_states", "State messages that wait for the next round.", now.queued)
    yield refusals(now.refused, REASONS)
    yield counter("fleet_reach_tubes", "Tubes published.", dict(tally.by_label), "label", "method")
    yield counter("fleet_reach_events", "Events published.", dict(tally.by_kind), "kind")
    yield counter(
        "fleet_reach_events_withheld", "Events held back, too many of a kind about one vehicle.", tally.withheld
    )
    yield counter("fleet_reach_failures", "Rounds that failed; their samples are lost.", tally.failures)
    yield gauge(
        "fleet_reach_round_timestamp_seconds", "When the newest round was over, Unix time.", tally.round_ns / 1e9
    )
    yield histogram(
        "fleet_reach_tube_latency_seconds", "From the arrival of a sample to its published tube.", tally.tube_latency
    )
    yield gauge("fleet_reach_behind_seconds", "Age of the oldest sample of the newest round at its end.", now.behind)
    yield histogram("fleet_reach_batch_samples", "Samples of a round, of rounds that had any.", tally.batch)
    yield counter("fleet_reach_stage_seconds", "Time spent in each stage of the rounds.", dict(now.seconds), "stage")
    yield counter("fleet_reach_checked", "One-step predictions held against what was measured.", checks.checked)
    yield counter("fleet_reach_inside", "Of those, measurements inside of their sets.", checks.inside)
    yield counter("fleet_reach_misses", "Of those, measurements outside of their sets.", checks.checked - checks.inside)
    yield counter(
        "fleet_reach_expected_misses", "Misses that the claims of the classes let expect.", checks.expected_misses
    )
    with_tube = sum(fleet.newest.values())
    states = {
        "tube": with_tube, "waiting": fleet.waiting, "other": max(fleet.known - with_tube - fleet.waiting, 0)
    }  # fmt: skip
    yield gauge(
        "fleet_reach_vehicles",
        "Vehicles known: with a tube, waiting for one, without profile or gone.",
        states,
        "state",
    )
    yield gauge("fleet_reach_newest_tubes", "Vehicles by the label of their newest tube.", fleet.newest, "label")
    yield gauge("fleet_reach_engines", "Classes of vehicles.", fleet.engines)
    yield gauge(
        "fleet_reach_clocks_off",
        "Vehicles whose clocks differ from the server's by more than allowed.",
        fleet.clocks_off,
    )
    yield gauge("fleet_reach_clock_offset_seconds", "Greatest difference of a vehicle's clock.", fleet.clock_offset)
    yield gauge("fleet_reach_problems", "Problems that the status of the server names.", fleet.problems)
