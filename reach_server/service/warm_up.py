"""``python -m reach_server.service.warm_up [METHOD…]``: compile what else is compiled at its first call.

The machine code is kept in the user's cache (``numeric.kernel_cache``); a second run takes seconds.
"""

import os
import sys
import time
from collections.abc import Sequence

import numpy as np

from fleet_bus.messages import VehicleProfile, parse_profile
from reach_server.data.window import SampleBatch
from reach_server.engine.engine import Engine, PlannedInputs
from reach_server.numeric.kernel_cache import cache_folder
from reach_server.service.kernel_list import compile_ahead, missing
from reach_server.sets import support
from reach_server.sets.polygon import zonotope_area
from side_info import Scenario

SAMPLES = 420
START, STEP = 10**18, 50_000_000
#: Each process loads the compiler, which takes two seconds and 200 MB.
MOST_PROCESSES = 8
#: What only constrained cuts need is listed as if for a method of this name.
CONSTRAINED = "constrained"
METHODS = ("set_membership", "paper", "calibrated")
SCENARIO = """
scenario: warm-up
version: 1
state: {x: m, v: m/s}
time: {zero: on_start, semantics: sampled}
regions: {S: {box: {x: [-999, 999], v: [-9, 9]}}, L: "1000 - sqrt(x * x + 1) >= 0"}
assume: always[0:1000 s](S) and always[20.5 s:22 s](L)
"""


def profile() -> VehicleProfile:
    """A vehicle of four states and two inputs in its own frame; every bound is given."""
    return parse_profile(
        {
            "class": "warm-up",
            "state": {"x": "m", "y": "m", "yaw": {"unit": "rad", "angle": True}, "v": "m/s"},
            "inputs": {name: {"unit": "1", "limits": [-1, 1]} for name in ("steering", "throttle")},
            "sample_time": STEP / 1e9,
            "frame": "body",
            "input_lags": 1,
            "window": 400,
            "noise": {
                "process": {"box": [0.1] * 4, "origin": "given"},
                "measurement": {"box": [0.01] * 4, "origin": "given"},
            },
            "lipschitz": {"matrix": [[1.0] * 5] * 4, "origin": "given"},
            "future_inputs": "plan",
            "roles": {"position": ["x", "y"], "heading": "yaw", "speed": "v", "steering": "steering"},
        }
    )


def main(methods: Sequence[str] = METHODS) -> int:
    """Have all kernels of some methods, without names of all, in the cache; say on stderr what goes on."""
    processes = min(len(os.sched_getaffinity(0)), MOST_PROCESSES)
    every = set(methods) == set(METHODS)
    wanted = missing([*methods, *([CONSTRAINED] if every else [])]) if cache_folder() is not None else []
    if processes > 1 and len(wanted) > 1:
        began = time.monotonic()
        say(f"compiling {len(wanted)} kernels in {processes} processes, half a minute to two minutes, once …")
        for done, name in compile_ahead(wanted, processes):
            say(f"  {done} of {len(wanted)} after {time.monotonic() - began:.0f} s: {name.rpartition(':')[2]}")
    elif wanted:
        say(f"compiling {len(wanted)} kernels, one to three minutes, once …")
    run(methods)
    if every:
        # An engine with such a profile compiles it when it is made.
        support.warm_up()
    return 0


def say(line: str) -> None:
    """A line on stderr, at once."""
    print(line, file=sys.stderr, flush=True)


def run(methods: Sequence[str]) -> None:
    """Run each method once, in vain: what is compiled at its first call then is."""
    rng = np.random.default_rng(0)
    u = rng.uniform(-0.5, 0.5, (SAMPLES + 12, 2))
    x = np.zeros((SAMPLES, 4))
    for k in range(SAMPLES - 1):
        v, yaw = 1.0 + 0.1 * u[k, 1], x[k, 2]
        x[k + 1] = [x[k, 0] + 0.05 * v * np.cos(yaw), x[k, 1] + 0.05 * v * np.sin(yaw), yaw + 0.05 * u[k, 0], v]
    x += rng.uniform(-0.001, 0.001, x.shape)
    for method in methods:
        engine = Engine(profile(), method=method, planned=True)
        engine.add("car")
        for scenario in (False, True):
            if scenario:
                engine.assign("car", Scenario.parse(SCENARIO, "warm-up"), START)
            for first, last in ((0, SAMPLES - 12), (SAMPLES - 12, SAMPLES)):
                rows = np.arange(first, last)
                one = np.ones(len(rows), dtype=np.uint64)
                seq, t = rows.astype(np.uint64), START + rows * STEP
                batch = SampleBatch(
                    np.zeros(len(rows), dtype=np.intp),
                    one,
                    seq,
                    t,
                    np.zeros(len(rows), dtype=np.uint32),
                    x[rows],
                    u[rows],
                )
                engine.step(batch, PlannedInputs(u[None, last : last + engine.horizon - 1], np.zeros((1, 2))))
    zonotope_area(np.zeros((1, 2, 1)))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:] or METHODS))
