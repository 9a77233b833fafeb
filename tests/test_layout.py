"""Who imports whom, who knows the network and the clock, and how much has to be touched to add something."""

import ast
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from fleet_bus.messages import Label
from fleet_bus.messages.methods import METHODS
from reach_server import Engine
from reach_server.methods import Claim, Method, Setup, registry
from reach_server.methods.registry import find, forget, register, registered
from reach_server.predicates.cut_kinds import CUT_KINDS
from tests.docs.test_docs import PACKAGES
from tests.reach_server.drives import PROFILE, history, samples_of

ROOT = Path(__file__).resolve().parents[1]
#: Modules that read a clock, or the network, or wait.
EDGE = {"zenoh", "time", "datetime", "threading", "socket", "asyncio", "sched"}


def loaded_by(statement: str) -> set[str]:
    """Top-level modules that are loaded after a statement in a fresh interpreter."""
    code = f"{statement}\nimport json, sys\nprint(json.dumps(sorted({{m.partition('.')[0] for m in sys.modules}})))"
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    return set(json.loads(done.stdout))


@pytest.mark.parametrize(
    ("statement", "absent"),
    [
        ("import reach_server.sets", {"zenoh", "casadi", "lark", "pydantic", "msgpack"}),
        ("import fleet_bus.keys", {"zenoh", "pydantic"}),
        ("import fleet_bus.errors", {"zenoh", "pydantic"}),
        ("from reach_server import Engine", {"zenoh"}),
        ("import vehicle_agent.agent", {"casadi", "matplotlib", "numba"}),
        # Who is not asked for metrics loads nothing for them, and who is loads no server beside.
        ("import fleet_cli.main, fleet_cli.agents, side_info.service.service", {"prometheus_client"}),
        ("import reach_server.service.server", {"prometheus_client"}),
        ("import vehicle_agent.metrics", {"casadi", "matplotlib", "numba", "starlette", "uvicorn", "nicegui"}),
        ("import side_info", {"zenoh"}),
        ("import fleet_view", {"numba", "casadi", "reach_server"}),
        ("import fleet_foxglove.topics", {"foxglove", "numpy", "zenoh"}),
        ("import fleet_foxglove.scene", {"casadi", "numba", "side_info", "reach_server"}),
        ("import fleet_cli.main", {"foxglove"}),
        ("import fleet_dashboard.gateway", {"casadi", "lark", "nicegui", "numba", "side_info", "reach_server"}),
    ],
)
def test_a_face_loads_only_what_it_needs(statement: str, absent: set[str]) -> None:
    assert not loaded_by(statement) & absent


def imported(path: Path) -> set[str]:
    """Top-level modules that the import statements of a file name."""
    names: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names |= {alias.name.partition(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            names.add(node.module.partition(".")[0])
    return names


def test_only_the_service_knows_the_network_and_the_clock() -> None:
    inside = [p for p in (ROOT / "reach_server").rglob("*.py") if "service" not in p.relative_to(ROOT).parts]
    assert len(inside) > 80
    assert {str(p.relative_to(ROOT)): imported(p) & EDGE for p in inside if imported(p) & EDGE} == {}
    # The check can fail.
    assert imported(ROOT / "reach_server" / "service" / "server.py") & EDGE


def test_every_method_of_the_wire_is_registered_and_states_its_claim() -> None:
    assert set(registered()) == set(METHODS)
    for name in METHODS:
        claim = find(name).claim
        assert claim.rate != bool(claim.bounds)


def test_a_method_that_states_no_claim_is_uncovered_whatever_the_profile_states() -> None:
    @register("dummy")
    def _dummy(setup: Setup) -> Method:
        return find("set_membership").build(setup)

    try:
        assert PROFILE.guaranteed
        engine = Engine(PROFILE, method="dummy")
        engine.add("a")
        engine.append(samples_of(history(0), 0, 400))
        (label,) = engine.step(samples_of(history(0), 400, 401)).labels
        assert label is Label.UNCOVERED
        with pytest.raises(ValueError, match="registered already"):
            register("dummy", Claim(rate=True))(_dummy)
    finally:
        forget("dummy")
    assert "dummy" not in registry.registered()


def test_every_way_to_cut_of_the_wire_says_what_is_different_about_it() -> None:
    schema = json.loads((ROOT / "fleet_bus" / "schemas" / "fleet.profile.v1.json").read_text(encoding="utf-8"))
    assert set(schema["properties"]["cuts"]["enum"]) == set(CUT_KINDS)
    assert len(set(CUT_KINDS.values())) == len(CUT_KINDS)


def test_modules_of_more_than_350_lines_say_why() -> None:
    long = {}
    for package in (*PACKAGES, "benchmarks"):
        for path in (ROOT / package).rglob("*.py"):
            text = path.read_text(encoding="utf-8")
            said = " ".join((ast.get_docstring(ast.parse(text)) or "").split())
            if text.count("\n") > 350 and "in one module" not in said:
                long[str(path.relative_to(ROOT))] = text.count("\n")
    assert long == {}


def test_numbers_are_what_numpy_calls_them() -> None:
    from reach_server.numeric import types

    assert np.zeros(1).dtype == np.float64
    assert {"FloatArray", "IntArray", "BoolArray", "IndexArray"} <= set(vars(types))
