"""Recorded messages moved in time, as if they were put now."""

from dataclasses import replace

import numpy as np

from fleet_bus.messages import Assignment, Event, ReachTube, ServiceStatus, StateSample, ranges
from fleet_bus.pubsub import Received
from fleet_recorder import layout


def shifted(received: Received, by_ns: int) -> bytes:
    """Payload of a message whose times are later by ``by_ns``.

    The times of states, tubes, events and status, time zero of assignments; and the epochs by which an agent's start
    is told from another, so that a server that knows the recorded one takes this for a start of its own. Others come as
    they are: what a scenario's document says about time stands in its text. Raises ``MessageError`` for a payload that
    is not what its encoding says.
    """
    payload, encoding = received.payload, received.encoding
    match layout.schema_name(encoding):
        case "fleet.state.v1":
            sample = StateSample.decode(payload, encoding)
            return replace(sample, t=sample.t + by_ns, epoch=_epoch(sample.epoch, by_ns)).encode()
        case "fleet.tube.v1":
            tube = ReachTube.decode(payload, encoding)
            return replace(
                tube,
                t=tube.t + by_ns,
                times=tube.times + np.int64(by_ns),
                epoch=_epoch(tube.epoch, by_ns),
                server_epoch=_epoch(tube.server_epoch, by_ns),
            ).encode()
        case "fleet.assignment.v1":
            assignment = Assignment.decode(payload, encoding)
            return assignment.model_copy(update={"time_zero": assignment.time_zero + by_ns}).encode()
        case "fleet.event.v1":
            event = Event.decode(payload, encoding)
            return event.model_copy(update={"t": event.t + by_ns}).encode()
        case "fleet.status.v1":
            status = ServiceStatus.decode(payload, encoding)
            return status.model_copy(update={"t": status.t + by_ns, "started": status.started + by_ns}).encode()
    return payload


def _epoch(epoch: int, by_ns: int) -> int:
    """Another epoch, in the order of those it comes from; the same where that would be none."""
    moved = epoch + by_ns
    return moved if moved in ranges.EPOCH else epoch
