"""Draw where vehicles can be next: read reach tubes from a Zenoh router and write them as one SVG.

Needs Python, zenoh and msgpack; what it knows about the messages is in docs/reference/wire.md.
"""

import argparse
import json
import queue
import struct
import sys
import time
from html import escape
from pathlib import Path

import msgpack
import zenoh

ENCODING = "application/msgpack;fleet.tube.v1"
COLOURS = {"guaranteed": "#1b7837", "calibrated": "#2166ac", "uncovered": "#e08214", "contradicted": "#b2182b"}


def main() -> int:
    """Read, draw, and say what was drawn; 0 if at least one tube came, else 1."""
    options = parse_arguments()
    try:
        payloads = receive(options.router, f"reach/{options.vehicle}/tube", options.count, options.timeout)
    except zenoh.ZError as error:
        print(f"no connection to the router {options.router}: {error}", file=sys.stderr)
        return 1
    if not payloads:
        print(
            f"no tube on reach/{options.vehicle}/tube within {options.timeout:g} s: is a reach server running, does "
            "the vehicle publish, and is its window filled?",
            file=sys.stderr,
        )
        return 1
    tubes = [read_tube(payload) for payload in payloads]
    options.output.write_text(draw(tubes), encoding="utf-8")
    for tube in tubes:
        last = tube["steps"][-1]
        ahead = (last["time"] - tube["t"]) / 1e9
        print(f"{tube['vehicle']} seq {tube['seq']}: {tube['label']}, {ahead:.3g} s ahead, area {last['area']:.4g}")
    print(f"{len(tubes)} of {options.count} tubes drawn in {options.output}")
    return 0


def parse_arguments() -> argparse.Namespace:
    """The options of the command line."""
    parser = argparse.ArgumentParser(description="Draw reach tubes as SVG.")
    parser.add_argument("--router", default="tcp/127.0.0.1:7447", help="endpoint of the router")
    parser.add_argument("--vehicle", default="*", help="id of a vehicle; * is every one")
    parser.add_argument("--count", type=int, default=1, help="tubes to draw")
    parser.add_argument("--output", type=Path, default=Path("tubes.svg"), help="file to write")
    parser.add_argument("--timeout", type=float, default=10.0, help="seconds to wait for the tubes")
    options = parser.parse_args()
    if options.count < 1 or not options.timeout > 0:
        parser.error("--count and --timeout must be positive")
    return options


def receive(router: str, key: str, count: int, timeout: float) -> list[bytes]:
    """The next ``count`` tubes put on ``key``, or as many as come within ``timeout`` seconds."""
    settings = {
        "mode": "client",
        "connect/endpoints": [router],
        "connect/timeout_ms": 0,
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": False,
    }
    config = zenoh.Config()
    for name, value in settings.items():
        config.insert_json5(name, json.dumps(value))
    arrived: queue.Queue[zenoh.Sample] = queue.Queue()
    payloads: list[bytes] = []
    deadline = time.monotonic() + timeout
    with zenoh.open(config) as session, session.declare_subscriber(key, arrived.put):
        while len(payloads) < count:
            try:
                sample = arrived.get(timeout=max(0.0, deadline - time.monotonic()))
            except queue.Empty:
                break
            if sample.kind == zenoh.SampleKind.PUT and str(sample.encoding) == ENCODING:
                payloads.append(sample.payload.to_bytes())
    return payloads


def numbers(raw: bytes, code: str) -> list[float]:
    """Numbers of a bin: ``code`` is q (int64), d (float64) or f (float32), little-endian."""
    return list(struct.unpack(f"<{len(raw) // struct.calcsize(code)}{code}", raw))


def read_tube(payload: bytes) -> dict:
    """What is drawn of a tube: per step its time, area, center and outline in world coordinates."""
    fields = msgpack.unpackb(payload)
    times, areas = numbers(fields["T"], "q"), numbers(fields["a"], "d")
    centers, outlines = numbers(fields["c"], "d"), numbers(fields["o"], "f")
    h, n = len(times), len(fields["x"])
    first, second = fields["p"]
    vertices = len(outlines) // (2 * h)
    steps = []
    for k in range(h):
        center = (centers[k * n + first], centers[k * n + second])
        offsets = outlines[2 * vertices * k : 2 * vertices * (k + 1)]
        outline = [(center[0] + a, center[1] + b) for a, b in zip(offsets[::2], offsets[1::2], strict=True)]
        steps.append({"time": times[k], "area": areas[k], "center": center, "outline": outline})
    return {
        "vehicle": fields["v"],
        "seq": fields["s"],
        "t": fields["t"],
        "label": fields["l"],
        "axes": (fields["x"][first], fields["x"][second]),
        "steps": steps,
    }


def draw(tubes: list[dict], size: int = 800, margin: int = 40) -> str:
    """An SVG with the outline and center of every step of every tube, one scale for both axes."""
    points = [point for tube in tubes for step in tube["steps"] for point in (step["center"], *step["outline"])]
    low = [min(point[i] for point in points) for i in (0, 1)]
    high = [max(point[i] for point in points) for i in (0, 1)]
    scale = (size - 2 * margin) / max(high[0] - low[0], high[1] - low[1], 1e-9)

    def at(point: tuple[float, float]) -> tuple[str, str]:
        # The second axis of an SVG points down.
        return f"{margin + scale * (point[0] - low[0]):.2f}", f"{size - margin - scale * (point[1] - low[1]):.2f}"

    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {size} {size}" font-family="sans-serif" font-size="13">',
        f'<rect width="{size}" height="{size}" fill="white"/>',
    ]
    for tube in tubes:
        colour = COLOURS.get(tube["label"], "black")
        # The last step first, so that the nearer and usually smaller sets lie on top.
        for step in reversed(tube["steps"]):
            corners = " ".join(",".join(at(point)) for point in step["outline"])
            x, y = at(step["center"])
            parts.append(f'<polygon points="{corners}" fill="{colour}" fill-opacity="0.08" stroke="{colour}"/>')
            parts.append(f'<circle cx="{x}" cy="{y}" r="1.5" fill="{colour}"/>')
        x, y = at(tube["steps"][0]["center"])
        parts.append(f'<text x="{x}" y="{y}" fill="{colour}">{escape(tube["vehicle"])} {escape(tube["label"])}</text>')
    ranges = [f"{name} {a:.3f} to {b:.3f}" for name, a, b in zip(tubes[0]["axes"], low, high, strict=True)]
    parts.append(f'<text x="{margin}" y="{size - margin // 3}">{escape(", ".join(ranges))}</text>')
    return "\n".join([*parts, "</svg>", ""])


if __name__ == "__main__":
    sys.exit(main())
