"""Print the verdicts about vehicles as they change, and their events, from a Zenoh router.

Needs Python, zenoh and msgpack; what it knows about the messages is in docs/reference/wire.md.
"""

import argparse
import contextlib
import json
import queue

import msgpack
import zenoh

TUBE = "application/msgpack;fleet.tube.v1"
EVENT = "application/msgpack;fleet.event.v1"


def main() -> None:
    """Listen until interrupted."""
    parser = argparse.ArgumentParser(description="Print verdicts and events.")
    parser.add_argument("--router", default="tcp/127.0.0.1:7447", help="endpoint of the router")
    parser.add_argument("--vehicle", default="*", help="id of a vehicle; * is every one")
    options = parser.parse_args()
    config = zenoh.Config()
    config.insert_json5("mode", json.dumps("client"))
    config.insert_json5("connect/endpoints", json.dumps([options.router]))
    config.insert_json5("scouting/multicast/enabled", "false")
    arrived: queue.Queue[zenoh.Sample] = queue.Queue()
    known: dict[tuple[str, str], str] = {}
    with zenoh.open(config) as session, session.declare_subscriber(f"reach/{options.vehicle}/*", arrived.put):
        while True:
            sample = arrived.get()
            for line in describe(str(sample.encoding), sample.payload.to_bytes(), known):
                print(line, flush=True)


def describe(encoding: str, payload: bytes, known: dict[tuple[str, str], str]) -> list[str]:
    """Lines about a message; ``known`` has the verdict of each vehicle and requirement, and gets the new ones."""
    fields = msgpack.unpackb(payload)
    if encoding == EVENT:
        details = ", ".join(f"{name} {value}" for name, value in fields.get("details", {}).items())
        return [f"{fields['vehicle']} event {fields['kind']}: {fields['message']} ({details})"]
    if encoding != TUBE:
        return []
    lines = []
    for requirement, verdict in fields["vd"].items():
        if known.get((fields["v"], requirement)) != verdict:
            known[fields["v"], requirement] = verdict
            lines.append(f"{fields['v']} {requirement}: {verdict}")
    return lines


if __name__ == "__main__":
    with contextlib.suppress(KeyboardInterrupt):
        main()
