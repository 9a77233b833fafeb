#!/usr/bin/env bash
# Library: eclipse-zenoh 1.10.2 (Python), zenoh.ext AdvancedPublisher and AdvancedSubscriber.
# Expected: an AdvancedSubscriber declared without a HistoryConfig gets no history, and one with max_age gets no
#   sample older than that; recovery by heartbeat brings back what was lost after the subscriber had come.
# Happens: as soon as recovery listens to heartbeats, the next heartbeat of a publisher that was silent since makes
#   both fetch its whole cache, however old. The documentation of RecoveryConfig speaks of missed samples only; it
#   does not say that everything before the declaration counts as missed, nor that max_age of the history does not
#   hold for it.
# Matters: a monitor that turns recovery on and restarts takes in stale states of vehicles that have stopped
#   publishing. The age has to be checked by the reader, against a time in the message.
set -euo pipefail
tmp=$(mktemp -d)
trap 'rm -rf "$tmp"' EXIT
python3 -m venv "$tmp/venv"
"$tmp/venv/bin/pip" install --quiet --quiet --no-compile --disable-pip-version-check eclipse-zenoh==1.10.2
"$tmp/venv/bin/python" - <<'PYTHON'
import json
import socket
import sys
import threading
import time
from importlib.metadata import version

import zenoh
from zenoh import ext

OLD = list(range(10))
NEW = 99
MAX_AGE = 0.2


def settings(mode: str, **endpoints: str) -> zenoh.Config:
    config = zenoh.Config()
    for key, value in {
        "mode": mode,
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": False,
        "transport/shared_memory/enabled": False,
        "timestamping/enabled": True,
        **{f"{kind}/endpoints": [endpoint] for kind, endpoint in endpoints.items()},
    }.items():
        config.insert_json5(key, json.dumps(value))
    return config


class Reader:
    """What one AdvancedSubscriber was handed."""

    def __init__(self, session: zenoh.Session, **options: object) -> None:
        self.got: list[int] = []
        self._changed = threading.Condition()
        self._subscriber = ext.declare_advanced_subscriber(session, "fleet/v1/state", self._take, **options)

    def _take(self, sample: zenoh.Sample) -> None:
        with self._changed:
            self.got.append(sample.payload.to_bytes()[0])
            self._changed.notify_all()

    def wait(self, number: int) -> None:
        with self._changed:
            if not self._changed.wait_for(lambda: number in self.got, 15):
                sys.exit(f"changed: sample {number} never came; got {self.got}")


with socket.socket() as free:
    free.bind(("127.0.0.1", 0))
    at = f"tcp/127.0.0.1:{free.getsockname()[1]}"
with (
    zenoh.open(settings("router", listen=at)),
    zenoh.open(settings("client", connect=at)) as vehicle,
    zenoh.open(settings("client", connect=at)) as monitor,
):
    publisher = ext.declare_advanced_publisher(
        vehicle,
        "fleet/v1/state",
        cache=ext.CacheConfig(max_samples=len(OLD)),
        sample_miss_detection=ext.MissDetectionConfig(heartbeat=0.2),
        publisher_detection=True,
    )
    for number in OLD:
        publisher.put(bytes([number]))
    threading.Event().wait(1.0)  # all are older than MAX_AGE now
    heartbeat = ext.RecoveryConfig(heartbeat=True)
    young = ext.HistoryConfig(max_age=MAX_AGE)
    plain = Reader(monitor)
    aged = Reader(monitor, history=young)
    recovering = Reader(monitor, recovery=heartbeat)
    aged_recovering = Reader(monitor, history=young, recovery=heartbeat)
    deadline = time.monotonic() + 15
    readers = (plain, aged, recovering, aged_recovering)
    while any(len(reader.got) < len(OLD) for reader in readers[2:]) and time.monotonic() < deadline:
        threading.Event().wait(0.05)
    publisher.put(bytes([NEW]))
    for reader in readers:
        reader.wait(NEW)

print("eclipse-zenoh", version("eclipse-zenoh"))
print(f"published 1 s before the subscribers came: {OLD}; after they had come: {NEW}")
print("no history, no recovery:           ", plain.got)
print(f"max_age {MAX_AGE} s, no recovery:          ", aged.got)
print("no history, heartbeat recovery:    ", recovering.got)
print(f"max_age {MAX_AGE} s, heartbeat recovery:   ", aged_recovering.got)
if plain.got != [NEW] or aged.got != [NEW]:
    sys.exit("changed: without recovery, samples from before the declaration came")
if recovering.got != [*OLD, NEW] or aged_recovering.got != [*OLD, NEW]:
    sys.exit("changed: the heartbeat no longer fetches the samples from before the declaration")
PYTHON
