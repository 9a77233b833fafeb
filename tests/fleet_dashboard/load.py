"""How much the page costs, and whom a stuck client holds up: ``python -m tests.fleet_dashboard.load``.

A router and a process that puts tubes of ten steps, as fast as it is told; the page as it is started by ``fleet
dashboard``; clients of its socket, and with ``--browser`` a Chromium that draws by software. CPU time is that of the
page's process alone, as a share of one core.
"""

import argparse
import asyncio
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from threading import Thread
from typing import Any

import numpy as np
import websockets

from fleet_bus import Role, keys, open_session
from fleet_bus.messages.tube import ENCODING
from fleet_bus.router import Router
from tests.fleet_dashboard.messages import tube

ROOT = Path(__file__).resolve().parents[2]
PHASES = 5
#: A sequence number of full width, so that it can be written over.
FIRST = 2**40


def payloads(vehicles: int) -> list[list[bytearray]]:
    """Tubes of all vehicles for some phases of their way, on a square of a few metres for each."""
    side = max(1, round(vehicles**0.5))
    found = []
    for phase in range(PHASES):
        turn = 2 * np.pi * phase / PHASES
        found.append(
            [
                bytearray(
                    tube(
                        f"v{k}", at=(2.0 * (k % side) + 0.3 * np.cos(turn), 2.0 * (k // side) + 0.3 * np.sin(turn)),
                        seq=FIRST, steps=10, corners=16, radius=0.6,
                    ).encode()
                )
                for k in range(vehicles)
            ]
        )  # fmt: skip
    return found


def publish(router: str, vehicles: int, rate: float) -> None:
    """Put a tube of each vehicle ``rate`` times a second until ended, spread evenly."""
    made = payloads(vehicles)
    places = [[bytes(payload).index(b"\xa1s\xcf") + 3 for payload in phase] for phase in made]
    with open_session(Role.SERVICE, [router]) as session:
        publishers = [session.declare_publisher(keys.tube(f"v{k}"), encoding=ENCODING) for k in range(vehicles)]
        print("publishing", flush=True)
        begun, sent = time.monotonic(), 0
        told, before = begun, 0
        while True:
            due = int((time.monotonic() - begun) * rate * vehicles)
            for n in range(sent, due):
                k, round_ = n % vehicles, n // vehicles
                payload = made[round_ % PHASES][k]
                place = places[round_ % PHASES][k]
                payload[place : place + 8] = (FIRST + round_).to_bytes(8, "big")
                publishers[k].put(bytes(payload))
            sent = max(sent, due)
            now = time.monotonic()
            if now >= told + 2:
                print(f"put {(sent - before) / (now - told):.0f} tubes a second", flush=True)
                told, before = now, sent
            time.sleep(0.005)


def cpu_seconds(pid: int) -> float:
    """CPU time of a process so far, s."""
    parts = Path(f"/proc/{pid}/stat").read_text(encoding="ascii").rpartition(")")[2].split()
    return (int(parts[11]) + int(parts[12])) / os.sysconf("SC_CLK_TCK")


class Client:
    """A client of the page's socket that sees everything, and notes when frames came."""

    def __init__(self, url: str, vehicles: int) -> None:
        side = 2.0 * max(1, round(vehicles**0.5))
        self._url = f"{url.replace('http', 'ws', 1)}live/load"
        self._view = {"view": [-2, -2, side + 2, side + 2], "pixels": 800 / side}
        self.times: list[float] = []
        self.bytes = 0

    async def run(self, seconds: float, *, stuck: bool = False) -> None:
        """Take frames for some seconds; a stuck client reads nothing after it has said what it sees."""
        async with websockets.connect(self._url, max_size=None, compression=None, max_queue=1) as socket:
            await socket.send(json.dumps(self._view))
            if stuck:
                await asyncio.sleep(seconds)
                socket.transport.abort()
                return
            end = time.monotonic() + seconds
            while time.monotonic() < end:
                message = await socket.recv()
                if isinstance(message, bytes):
                    self.times.append(time.monotonic())
                    self.bytes += len(message)


async def measure(url: str, pid: int, vehicles: int, seconds: float) -> dict[str, Any]:
    """CPU of page and gateway without a client, with one, and with ten beside one that is stuck."""
    found: dict[str, Any] = {"vehicles": vehicles}
    for name, healthy, stuck in (
        ("no client", 0, 0),
        ("one client", 1, 0),
        ("ten clients", 10, 0),
        ("ten and a stuck one", 10, 1),
    ):
        clients = [Client(url, vehicles) for _ in range(healthy)]
        tasks = [asyncio.create_task(client.run(seconds)) for client in clients]
        tasks += [asyncio.create_task(Client(url, vehicles).run(seconds, stuck=True)) for _ in range(stuck)]
        before, begun = cpu_seconds(pid), time.monotonic()
        await asyncio.sleep(seconds)
        await asyncio.gather(*tasks)
        taken = time.monotonic() - begun
        gaps = [1e3 * gap for client in clients for gap in np.diff(client.times[3:]).tolist()]
        found[name] = {"cores": round((cpu_seconds(pid) - before) / taken, 3)}
        if clients:
            found[name] |= {
                "frames_a_second": round(sum(len(client.times) for client in clients) / taken / healthy, 1),
                "kB_a_frame": round(sum(c.bytes for c in clients) / max(1, sum(len(c.times) for c in clients)) / 1e3),
                "ms_between_frames": {
                    "p50": round(float(np.quantile(gaps, 0.5))),
                    "p99": round(float(np.quantile(gaps, 0.99))),
                },
            }
        print(f"{vehicles} vehicles, {name}: {found[name]}", flush=True)
    return found


def draw(url: str, pid: int, seconds: float, vehicles: int) -> None:
    """Print frames a second that Chromium takes and draws by software, and what it costs to serve it the whole page."""
    from playwright.sync_api import sync_playwright

    from tests.browser import ARGUMENTS, CHROMIUM

    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=list(ARGUMENTS))
        page = browser.new_page(viewport={"width": 1280, "height": 800})
        page.goto(url)
        page.wait_for_function("window.fleetMap && fleetMap.frame && fleetMap.frame.polygons > 0")
        asked = "({...fleetMap.stats, now: performance.now()})"
        cores, before = cpu_seconds(pid), page.evaluate(asked)
        page.wait_for_timeout(1000 * seconds)
        cores, after = cpu_seconds(pid) - cores, page.evaluate(asked)
        browser.close()
    taken = (after["now"] - before["now"]) / 1e3
    frames, drawn = ((after[name] - before[name]) / taken for name in ("frames", "drawn"))
    print(
        f"{vehicles} vehicles in Chromium, by software: {frames:.1f} frames taken a second, {drawn:.1f} drawn; "
        f"page and gateway: {cores / taken:.3f} cores"
    )


def main() -> int:
    """Measure and print."""
    parser = argparse.ArgumentParser(description="What the page costs.")
    parser.add_argument("--vehicles", type=int, nargs="+", default=[200, 1000])
    parser.add_argument("--rate", type=float, default=10.0, help="tubes of each vehicle a second")
    parser.add_argument("--seconds", type=float, default=15.0, help="of each measurement")
    parser.add_argument("--browser", action="store_true", help="draw in Chromium, too")
    parser.add_argument("--publish", metavar="ROUTER", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.publish:
        publish(options.publish, options.vehicles[0], options.rate)
        return 0
    for vehicles in options.vehicles:
        with Router(["tcp/127.0.0.1:0"]) as router:
            at = router.endpoints[0]
            started = [
                _start(
                    "tests.fleet_dashboard.load",
                    "--publish",
                    at,
                    "--vehicles",
                    str(vehicles),
                    "--rate",
                    str(options.rate),
                ),
                _start("fleet_cli", "dashboard", "--port", "0", "--router", at),
            ]
            puts: list[str] = []
            try:
                _line(started[0], "publishing")
                assert started[0].stdout is not None
                Thread(target=puts.extend, args=(started[0].stdout,), daemon=True).start()
                url = _line(started[1], "page on ").rpartition(" ")[2]
                asyncio.run(measure(url, started[1].pid, vehicles, options.seconds))
                print(f"meanwhile the publisher {', '.join(sorted({line.strip() for line in puts})[:1])} at least")
                if options.browser:
                    draw(url, started[1].pid, options.seconds, vehicles)
            finally:
                for process in started:
                    process.send_signal(signal.SIGTERM)
                for process in started:
                    process.wait()
    return 0


def _start(module: str, *arguments: str) -> "subprocess.Popen[str]":
    return subprocess.Popen([sys.executable, "-m", module, *arguments], stdout=subprocess.PIPE, text=True, cwd=ROOT)


def _line(process: "subprocess.Popen[str]", text: str) -> str:
    assert process.stdout is not None
    for line in process.stdout:
        if text in line:
            return line.strip()
    raise RuntimeError(f"ended before it said {text!r}")


if __name__ == "__main__":
    sys.exit(main())
