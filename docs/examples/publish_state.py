"""Publish profile and states of a vehicle to a Zenoh router, so that a reach server makes tubes of them.

Needs Python, zenoh and msgpack; what it knows about the messages is in docs/reference/wire.md. The vehicle is a made-up
cart on a table: for your own, write PROFILE, and yield what its sensors say where ``drive`` computes.
"""

import argparse
import json
import math
import random
import struct
import sys
import time
from collections.abc import Iterator

import msgpack
import zenoh
from zenoh import ext

STATE = "application/msgpack;fleet.state.v1"
PROFILE_ENCODING = "application/msgpack;fleet.profile.v1"
NEW_TRAJECTORY, HISTORY = 2, 8

SAMPLE_TIME = 0.1
WINDOW = 100
#: Half-widths of the errors of the measured states, and of what moves the cart beside its inputs. They must hold.
MEASUREMENT = [0.002, 0.002, 0.005, 0.005]
PROCESS = [0.0005, 0.0005, 0.002, 0.002]
PROFILE = {
    "class": "cart",
    "state": {
        "x": {"unit": "m", "rate": 2.0},
        "y": {"unit": "m", "rate": 2.0},
        "vx": {"unit": "m/s", "limits": [-2.0, 2.0]},
        "vy": {"unit": "m/s", "limits": [-2.0, 2.0]},
    },
    "inputs": {"ax": {"unit": "m/s^2", "limits": [-1.5, 1.5]}, "ay": {"unit": "m/s^2", "limits": [-1.5, 1.5]}},
    "sample_time": SAMPLE_TIME,
    "window": WINDOW,
    "noise": {
        "process": {"box": PROCESS, "origin": "given"},
        "measurement": {"box": MEASUREMENT, "origin": "given"},
    },
    "future_inputs": "limits",
    "roles": {"position": ["x", "y"]},
    "method": "lti",
}


def main() -> int:
    """Publish a history, then a sample each 0.1 s; 0 once all are sent."""
    parser = argparse.ArgumentParser(description="Publish the states of a made-up cart.")
    parser.add_argument("--router", default="tcp/127.0.0.1:7447", help="endpoint of the router")
    parser.add_argument("--vehicle", default="cart1", help="id of the vehicle")
    parser.add_argument("--count", type=int, default=0, help="live samples; 0 goes on until interrupted")
    options = parser.parse_args()
    config = zenoh.Config()
    for name, value in {
        "mode": "peer",
        "listen/endpoints": [],
        "connect/endpoints": [options.router],
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": False,
        "timestamping/enabled": True,
        "transport/link/tx/lease": 2000,
        "transport/shared_memory/enabled": False,
    }.items():
        config.insert_json5(name, json.dumps(value))
    with zenoh.open(config) as session:
        publish(session, options.vehicle, options.count)
    print(f"{options.vehicle}: all sent")
    return 0


def publish(session: zenoh.Session, vehicle: str, count: int) -> None:
    """Put profile, history, liveliness token and ``count`` live samples."""
    profile = publisher(session, f"fleet/{vehicle}/profile", PROFILE_ENCODING, cache=1)
    states = publisher(session, f"fleet/{vehicle}/state", STATE, cache=WINDOW + 64)
    # msgpack keeps the order of a dict: that of the states and inputs is the order of x and u.
    profile.put(msgpack.packb(PROFILE))
    # A start that comes later has a greater epoch, and its samples count from 0.
    epoch = time.time_ns()
    step = round(SAMPLE_TIME * 1e9)
    samples = drive(random.Random(1))
    # What was recorded before fills the window at once. Stamps end one sample time before now.
    for seq in range(WINDOW):
        x, u = next(samples)
        flags = HISTORY | (NEW_TRAJECTORY if seq == 0 else 0)
        states.put(state_message(epoch, seq, epoch + (seq - WINDOW) * step, x, u, flags))
    token = session.liveliness().declare_token(f"fleet/{vehicle}/alive")
    for number, (x, u) in enumerate(samples):
        if count and number == count:
            break
        t = epoch + number * step
        time.sleep(max(0.0, (t - time.time_ns()) / 1e9))
        states.put(state_message(epoch, WINDOW + number, t, x, u, 0))
    token.undeclare()
    for each in (states, profile):
        each.undeclare()


def publisher(session: zenoh.Session, key: str, encoding: str, cache: int) -> ext.AdvancedPublisher:
    """A publisher of which who comes later gets the last ``cache`` messages."""
    return ext.declare_advanced_publisher(
        session,
        key,
        encoding=encoding,
        priority=zenoh.Priority.DATA_HIGH,
        congestion_control=zenoh.CongestionControl.DROP,
        cache=ext.CacheConfig(cache),
        sample_miss_detection=ext.MissDetectionConfig(heartbeat=1.0, sporadic_heartbeat=None),
        publisher_detection=True,
    )


def state_message(epoch: int, seq: int, t: int, x: list[float], u: list[float], flags: int) -> bytes:
    """A state sample: a header of 40 bytes, then the numbers of x and u, all little-endian."""
    header = struct.pack("<QQqIHHHH4x", epoch, seq, t, flags, len(x), len(u), 0, 0)
    return msgpack.packb({"d": header + struct.pack(f"<{len(x) + len(u)}d", *x, *u)})


def drive(chance: random.Random) -> Iterator[tuple[list[float], list[float]]]:
    """The measured state of each sample, and the input that is in force from then on."""
    x = [1.0, 0.0, 0.0, 0.8]
    k = 0
    while True:
        # Around the middle, and back and forth: from inputs that only follow the state no model can be learned.
        swings = 0.6 * math.sin(0.37 * k), 0.6 * math.cos(0.61 * k)
        u = [swing - 0.64 * x[i] - 0.1 * x[i + 2] for i, swing in enumerate(swings)]
        u = [min(1.5, max(-1.5, a)) for a in u]
        yield [value + chance.uniform(-b, b) for value, b in zip(x, MEASUREMENT, strict=True)], u
        moved = [x[i] + SAMPLE_TIME * x[i + 2] + SAMPLE_TIME**2 / 2 * u[i] for i in (0, 1)]
        faster = [x[i + 2] + SAMPLE_TIME * u[i] for i in (0, 1)]
        x = [value + chance.uniform(-b, b) for value, b in zip([*moved, *faster], PROCESS, strict=True)]
        k += 1


if __name__ == "__main__":
    try:
        sys.exit(main())
    except KeyboardInterrupt:
        sys.exit(130)
