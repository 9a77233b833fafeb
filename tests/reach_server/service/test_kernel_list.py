"""Kernels that can be compiled ahead are those that servers call, each for one kind of arguments."""

import ast
import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from numba.core import types as numba_types

from reach_server.models.conformal.spec import FeatureSpec
from reach_server.numeric.signatures import decoded, encoded
from reach_server.service.kernel_list import Kernel, listed
from reach_server.service.warm_up import CONSTRAINED, METHODS

#: Numba's stubs know little of its types.
types: Any = numba_types
ROOT = Path(__file__).resolve().parents[3]
DECORATORS = {
    "kernel", "leaf_kernel", "reduction_kernel", "leaf_reduction_kernel", "inline", "inline_reduction",
}  # fmt: skip


def child(code: str, **environment: str) -> str:
    done = subprocess.run(
        [sys.executable, "-c", code], env={**os.environ, **environment}, capture_output=True, text=True, check=True
    )
    return done.stdout


@pytest.mark.slow
@pytest.mark.parametrize("method", METHODS)
def test_the_kernels_that_a_method_calls_are_listed(method: str) -> None:
    code = (
        "import json; from reach_server.service import kernel_list, warm_up; "
        f"warm_up.run(['{method}']); print(json.dumps(sorted(kernel_list.called())))"
    )
    found = {Kernel(*row) for row in json.loads(child(code))}
    assert found == set(listed([method])), "python .ci/kernel_list.py"


@pytest.mark.slow
def test_several_processes_compile_what_is_missing(tmp_path: Path) -> None:
    code = """
from reach_server.service.kernel_list import compile_ahead, listed, missing
kernels = [kernel for kernel in listed(["set_membership"]) if kernel.name.endswith((":scan", ":columns_added"))]
before = missing(["set_membership"])
print(len(kernels), set(kernels) <= set(before), sorted(done for done, _ in compile_ahead(kernels, 2)))
print(len(before) - len(missing(["set_membership"])), set(kernels) & set(missing(["set_membership"])))
"""
    # A script in a file: processes that are started anew read it again.
    script = tmp_path / "script.py"
    script.write_text("if __name__ == '__main__':\n" + code.replace("\n", "\n    "), encoding="utf-8")
    done = subprocess.run(
        [sys.executable, script], env={**os.environ, "FLEET_KERNEL_CACHE": str(tmp_path), "PYTHONPATH": str(ROOT)},
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    assert done.stdout.splitlines() == ["2 True [1, 2]", "2 set()"]


def test_methods_share_most_of_what_is_listed() -> None:
    every = listed([*METHODS, CONSTRAINED])
    assert len(set(every)) == len(every) > len(listed(["set_membership"])) > 10
    assert all(kernel.name.startswith("reach_server.") for kernel in every)


KINDS = (
    types.int64, types.float64, types.boolean, types.uint8,
    types.Array(types.float64, 2, "C"), types.Array(types.bool_, 3, "A", readonly=True),
    types.UniTuple(types.int64, 3), types.Tuple((types.int64, types.float64)),
    types.NamedUniTuple(types.int64, len(FeatureSpec._fields), FeatureSpec),
)  # fmt: skip


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: str(kind)[:40])
def test_types_of_arguments_survive_json(kind: Any) -> None:
    assert decoded(json.loads(json.dumps(encoded(kind)))) == kind


def test_what_is_no_type_of_an_argument_is_refused() -> None:
    for kind in (types.unicode_type, types.List(types.int64), types.IntegerLiteral(3)):
        with pytest.raises(TypeError, match="compiled ahead"):
            encoded(kind)
    for text in ("no_such_type", "Array", 3, None, {"list": ["int64"]}, {"array": 1, "tuple": 2}):
        with pytest.raises((ValueError, TypeError), match=r"no type|unpack"):
            decoded(text)
    with pytest.raises(ValueError, match="is not of reach_server"):
        decoded({"named": ["os:stat_result", []]})


def kernels() -> dict[str, ast.FunctionDef]:
    """Compiled functions by name; no two modules have one of the same name that others call."""
    found = {}
    for path in (ROOT / "reach_server").rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.FunctionDef):
                names = {d.id for d in node.decorator_list if isinstance(d, ast.Name)}
                if names & DECORATORS:
                    found[node.name] = node
    return found


def test_no_kernel_calls_another_with_a_literal() -> None:
    """Numba gives a literal in a call a type of its own and compiles the kernel, and all below it, once more."""
    every = kernels()
    assert len(every) > 100
    literal = []
    for name, function in every.items():
        for node in ast.walk(function):
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id in every:
                given = [arg.operand if isinstance(arg, ast.UnaryOp) else arg for arg in node.args]
                if any(isinstance(arg, ast.Constant) and isinstance(arg.value, int) for arg in given):
                    literal.append(f"{name} calls {node.func.id}")
    assert literal == []
