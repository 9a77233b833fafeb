#!/usr/bin/env bash
# Library: eclipse-zenoh 1.10.2 (Python; the wheel contains the router), setting `downsampling`.
# Expected: the rule {key_expr: "fleet/*/state", freq: 1} lets each matching key pass once a second, as the same
#   rule written out once per key does.
# Happens: all keys that match the rule share one clock. Of five vehicles that publish in step, always in the same
#   order, the first gets through each time and the others never do. The commented configuration speaks of "the
#   maximum frequency" of a key expression and has an example without a wildcard only.
# Matters: thinning a fleet's telemetry by wildcard in the router does not thin it, it silences vehicles for good, and
#   nothing tells the reader. Thin where it is published, or write a rule per vehicle.
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
from collections import Counter
from importlib.metadata import version

import zenoh

ROUNDS = 4
VEHICLES = [f"fleet/v{number}/state" for number in range(1, 6)]


def settings(mode: str, **more: object) -> zenoh.Config:
    config = zenoh.Config()
    for key, value in {
        "mode": mode,
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": False,
        "transport/shared_memory/enabled": False,
        **more,
    }.items():
        config.insert_json5(key, json.dumps(value))
    return config


def arrivals(keys: list[str]) -> Counter[str]:
    """Samples per key that pass a router which thins each of ``keys`` to one a second."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        at = [f"tcp/127.0.0.1:{free.getsockname()[1]}"]
    thin = [{"messages": ["put"], "flows": ["egress"], "rules": [{"key_expr": key, "freq": 1.0} for key in keys]}]
    count: Counter[str] = Counter()
    over = threading.Event()

    def take(sample: zenoh.Sample) -> None:
        count[str(sample.key_expr)] += 1
        if str(sample.key_expr) == "fleet/end":
            over.set()

    with (
        zenoh.open(settings("router", **{"listen/endpoints": at, "downsampling": thin})),
        zenoh.open(settings("client", **{"connect/endpoints": at})) as fleet,
        zenoh.open(settings("client", **{"connect/endpoints": at})) as reader,
    ):
        subscriber = reader.declare_subscriber("fleet/**", take)
        probe = fleet.declare_publisher("fleet/end")
        pause = threading.Event()
        for _ in range(200):  # until the route to the reader stands
            if probe.matching_status.matching:
                break
            pause.wait(0.05)
        for _ in range(ROUNDS):
            for vehicle in VEHICLES:
                fleet.put(vehicle, b"x")
            pause.wait(1.2)  # longer than the period of the rule
        probe.put(b"")
        if not over.wait(10):
            sys.exit("no answer from the router: nothing can be said")
    return count


one_rule = arrivals(["fleet/*/state"])
one_each = arrivals(VEHICLES)
print("eclipse-zenoh", version("eclipse-zenoh"))
print(f"published: {ROUNDS} of each of {len(VEHICLES)} keys, 1.2 s apart; allowed: one a second")
print("arrived by one rule with a wildcard:", {key: one_rule[key] for key in VEHICLES})
print("arrived by one rule for each key:   ", {key: one_each[key] for key in VEHICLES})
if any(one_each[key] < ROUNDS - 1 for key in VEHICLES):
    sys.exit("changed: separate rules no longer let every key pass at its rate")
if one_rule[VEHICLES[0]] < ROUNDS - 1 or any(one_rule[key] for key in VEHICLES[1:]):
    sys.exit("changed: a rule with a wildcard no longer starves all keys but the first")
PYTHON
