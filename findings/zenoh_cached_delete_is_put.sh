#!/usr/bin/env bash
# Library: eclipse-zenoh 1.10.2 (Python), zenoh.ext AdvancedPublisher and AdvancedSubscriber.
# Expected: a late subscriber that fetches history sees the same samples as a subscriber that was there in time, so
#   a `delete` reaches both as SampleKind.DELETE. Zenoh can carry that in an answer (`Query.reply_del` exists).
# Happens: the one who was there gets DELETE; the latecomer gets a PUT with an empty payload and encoding
#   zenoh/bytes. The documentation of `AdvancedPublisher.delete` and of `CacheConfig` says nothing of it.
# Matters: whoever joins late takes "this vehicle's profile is withdrawn" for a new, empty profile. A decoder must
#   refuse by encoding, and a withdrawal that has to survive a cache needs a message of its own.
set -euo pipefail
tmp=$(mktemp -d)
trap 'rm -rf "$tmp"' EXIT
python3 -m venv "$tmp/venv"
"$tmp/venv/bin/pip" install --quiet --quiet --no-compile --disable-pip-version-check eclipse-zenoh==1.10.2
"$tmp/venv/bin/python" - <<'PYTHON'
import json
import queue
import socket
import sys
from importlib.metadata import version

import zenoh
from zenoh import ext


def settings(mode: str, **endpoints: str) -> zenoh.Config:
    config = zenoh.Config()
    for key, value in {
        "mode": mode,
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": False,
        "transport/shared_memory/enabled": False,
        **{f"{kind}/endpoints": [endpoint] for kind, endpoint in endpoints.items()},
    }.items():
        config.insert_json5(key, json.dumps(value))
    return config


def seen(sample: zenoh.Sample) -> tuple[str, bytes, str]:
    return str(sample.kind), sample.payload.to_bytes(), str(sample.encoding)


with socket.socket() as free:
    free.bind(("127.0.0.1", 0))
    at = f"tcp/127.0.0.1:{free.getsockname()[1]}"
key = "fleet/v1/profile"
in_time: queue.Queue[zenoh.Sample] = queue.Queue()
late: queue.Queue[zenoh.Sample] = queue.Queue()
with (
    zenoh.open(settings("router", listen=at)),
    zenoh.open(settings("client", connect=at)) as vehicle,
    zenoh.open(settings("client", connect=at)) as reader,
):
    live = reader.declare_subscriber(key, in_time.put)
    publisher = ext.declare_advanced_publisher(
        vehicle, key, cache=ext.CacheConfig(max_samples=1), sample_miss_detection=ext.MissDetectionConfig()
    )
    for _ in range(100):  # until the route to the reader stands
        publisher.put(b"profile", encoding="application/msgpack")
        try:
            first = in_time.get(timeout=0.2)
        except queue.Empty:
            continue
        break
    else:
        sys.exit("no answer from the router: nothing can be said")
    publisher.delete()
    last = in_time.get(timeout=10)
    while last.kind == zenoh.SampleKind.PUT:
        last = in_time.get(timeout=10)
    behind = ext.declare_advanced_subscriber(reader, key, late.put, history=ext.HistoryConfig(max_samples=1))
    cached = late.get(timeout=10)

print("eclipse-zenoh", version("eclipse-zenoh"))
print("there in time:", seen(first), "then", seen(last))
print("came late:    ", seen(cached))
if last.kind != zenoh.SampleKind.DELETE:
    sys.exit("changed: the live subscriber did not see a DELETE")
if seen(cached) != (str(zenoh.SampleKind.PUT), b"", "zenoh/bytes"):
    sys.exit("changed: the cache no longer hands a delete out as an empty PUT")
PYTHON
