"""``python benchmarks/digest.py``: a hash of every set that the engine gives on drives and recordings, a line each.

Two commits that print the same lines give the same sets to the last bit; it uses public names only, so that it runs on
both. On the same machine: the order of sums, and with it the last bit, depends on the processor.
"""

import hashlib
import itertools
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fleet_bus.messages import StateFlag, VehicleProfile, load_profile
from reach_server import Engine, SampleBatch, Tubes
from side_info import Scenario
from vehicle_agent import svea
from vehicle_agent.route import load_route
from vehicle_agent.simulate import simulate_drive, simulate_history

ROOT = Path(__file__).resolve().parents[1]
RECORDINGS = {"fix_dart_free": "dart", "fix_f1tenth_koopman": "f1tenth", "fix_upenn_pf": "upenn"}
#: Scenarios, and the routes that keep them.
SCENARIOS = {
    "": "parking-lot",
    "parking-lot": "parking-lot",
    "parking-lot-motion": "parking-lot",
    "roundabout": "roundabout",
}
#: Rounds after the first, in which all but their samples come; samples of a history before a drive.
ROUNDS, HISTORY = 60, 600
VARIANTS = (
    ("set_membership", "zonotope"), ("set_membership", "constrained"), ("set_membership", "frobenius"),
    ("residual_hull", "zonotope"), ("calibrated", "zonotope"),
)  # fmt: skip


@dataclass(frozen=True)
class Samples:
    """Stamps (T,), states (T, n) and inputs (T, m) of a drive, of which the first ``history`` were recorded before."""

    t: np.ndarray
    x: np.ndarray
    u: np.ndarray
    history: int = 0

    def batch(self, first: int, last: int) -> SampleBatch:
        """Samples ``first`` to ``last`` of one vehicle."""
        rows = np.arange(first, last)
        flags = np.where(rows < self.history, int(StateFlag.HISTORY), 0).astype(np.uint32)
        flags[rows == self.history] |= int(StateFlag.NEW_TRAJECTORY)
        return SampleBatch(
            np.zeros(len(rows), np.intp), np.ones(len(rows), np.uint64), rows.astype(np.uint64), self.t[rows],
            flags, self.x[rows], self.u[rows],
        )  # fmt: skip


def digest(profile: VehicleProfile, method: str, samples: Samples, scenario: str = "") -> str:
    """Hash of all tubes of one vehicle: after its history, or all but the last samples, and after each few after."""
    engine, found = Engine(profile, method=method, planned=False), hashlib.sha256()
    engine.add("a")
    count = len(samples.t)
    start = samples.history + 1 if samples.history else count - ROUNDS
    if scenario:
        engine.assign("a", Scenario.load(scenario), int(samples.t[samples.history]))
    edges = [0, start, *range(start + 1, count + 1, max(1, (count - start) // (3 * ROUNDS)))]
    tubes = cuts = 0
    for first, last in itertools.pairwise(edges):
        result = engine.step(samples.batch(first, last))
        tubes, cuts = tubes + len(result.vehicles), cuts + sum(map(bool, result.cuts))
        for part in parts(result):
            found.update(part)
    return f"{tubes} tubes, {cuts} cut: {found.hexdigest()[:24]}"


def parts(tubes: Tubes) -> Iterator[bytes]:
    """All that tubes say, as bytes."""
    for sets in (*tubes.steps, *tubes.free):
        for array in (sets.center, sets.generators, sets.matrix, sets.offset):
            yield np.ascontiguousarray(array).tobytes()
    for array in (tubes.area, tubes.area_free, tubes.outline, tubes.hull):
        yield np.ascontiguousarray(array).tobytes()
    yield repr((tubes.labels, tubes.cuts, [dict(v) for v in tubes.verdicts])).encode()


def main() -> int:
    """Print a line for each drive, method and scenario."""
    names = {path.stem: path for path in ROOT.glob("fleet_*/profiles/*.yaml")}
    for recording, profile_name in RECORDINGS.items():
        path = next(p for name, p in names.items() if name.startswith(profile_name))
        profile = load_profile(path)
        with np.load(ROOT / "tests" / "data" / "recordings" / f"{recording}.npz", allow_pickle=False) as data:
            rows = np.flatnonzero(data["seg"] == np.bincount(data["seg"]).argmax())
            t = (10**18 + np.round((data["t"][rows] - data["t"][rows[0]]) * 1e9)).astype(np.int64)
            x, u = data["x"][rows].astype(float), data["u"][rows].astype(float)
        samples = Samples(t, x[:, : len(profile.state)], u[:, : len(profile.inputs)])
        for method in ("calibrated", "residual_hull", "paper"):
            print(recording, method, digest(profile, method, samples), flush=True)
    profile, before = svea.profile(), simulate_history(0, HISTORY)
    for scenario, route in SCENARIOS.items():
        drive = simulate_drive(load_route(route), 1)
        x, u = (np.concatenate(pair) for pair in ((before.measured, drive.measured), (before.inputs, drive.inputs)))
        samples = Samples(10**18 + np.arange(len(x)) * profile.sample_time_ns, x, u, HISTORY)
        for method, cuts in VARIANTS:
            inputs = "learned" if method == "calibrated" else "rate"
            own = profile.model_copy(update={"cuts": cuts, "future_inputs": inputs})
            print(route, scenario or "-", method, cuts, digest(own, method, samples, scenario), flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
