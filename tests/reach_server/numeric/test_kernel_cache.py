"""Machine code belongs to the sources that it was made of, wherever it is kept."""

import os
import platform
import shutil
import subprocess
import sys
from pathlib import Path

import llvmlite.binding as llvm
import pytest

import reach_server
from reach_server.numeric.kernel_cache import KEPT_VERSIONS
from reach_server.numeric.shipped_code import FEATURES

ROOT = Path(reach_server.__file__).parents[1]
AREA = """
import numpy as np
from reach_server.sets.polygon import _area_rows, zonotope_area
print(zonotope_area(np.array([[[1.0, 0.0], [0.0, 1.0]]]))[0], sum(_area_rows.stats.cache_misses.values()))
"""


def area(sources: Path, **places: str) -> tuple[float, int, str]:
    """Area of the unit box by a copy of the sources, how many kernels were compiled for it, and what was said."""
    environment = {key: value for key, value in os.environ.items() if key != "CACHE_DIRECTORY"}
    environment |= {"PYTHONPATH": f"{sources}{os.pathsep}{ROOT}", "PYTHONDONTWRITEBYTECODE": "1", **places}
    command = [sys.executable, "-c", AREA]
    done = subprocess.run(command, cwd=sources, env=environment, capture_output=True, text=True, check=True)
    value, misses = done.stdout.split()
    return float(value), int(misses), done.stderr


@pytest.fixture
def copy(tmp_path: Path) -> Path:
    """The package, copied, so that it can be edited."""
    ignored = shutil.ignore_patterns("__pycache__")
    shutil.copytree(ROOT / "reach_server", tmp_path / "reach_server", ignore=ignored)
    return tmp_path


@pytest.mark.slow
def test_an_edit_of_a_kernel_that_others_call_is_seen_and_its_revert_finds_the_old_code(copy: Path) -> None:
    cache = str(copy / "cache")
    called = copy / "reach_server" / "sets" / "kernels" / "planar.py"
    before = called.read_text()
    assert area(copy, FLEET_KERNEL_CACHE=cache)[:2] == (4.0, 1)
    assert area(copy, FLEET_KERNEL_CACHE=cache)[:2] == (4.0, 0)
    called.write_text(before.replace("    return 4.0 * total\n", "    return 400.0 * total\n", 1))
    assert area(copy, FLEET_KERNEL_CACHE=cache)[:2] == (400.0, 1)
    called.write_text(before)
    assert area(copy, FLEET_KERNEL_CACHE=cache)[:2] == (4.0, 0)


@pytest.mark.slow
def test_a_checkout_elsewhere_finds_the_code(copy: Path) -> None:
    cache = str(copy / "cache")
    area(copy, FLEET_KERNEL_CACHE=cache)
    other = copy / "elsewhere"
    other.mkdir()
    shutil.move(copy / "reach_server", other)
    assert area(other, FLEET_KERNEL_CACHE=cache)[:2] == (4.0, 0)


@pytest.mark.slow
def test_without_a_place_to_write_kernels_are_compiled_in_memory_and_a_warning_says_so(copy: Path) -> None:
    # Root may write to read-only folders: a file in the way stops everybody.
    blocked = copy / "blocked"
    blocked.write_text("")
    nowhere = str(blocked / "cache")
    value, misses, said = area(copy, FLEET_KERNEL_CACHE=nowhere, XDG_CACHE_HOME=nowhere, HOME=nowhere)
    assert (value, misses) == (4.0, 1)
    assert "FLEET_KERNEL_CACHE" in said


@pytest.mark.slow
def test_a_folder_that_others_can_write_to_is_not_trusted(copy: Path) -> None:
    shared = copy / "shared"
    (shared / "fleet-reach" / "kernels").mkdir(parents=True)
    (shared / "fleet-reach" / "kernels").chmod(0o777)
    private = copy / "private"
    area(copy, FLEET_KERNEL_CACHE=str(shared), XDG_CACHE_HOME=str(private))
    assert not list(shared.rglob("*.nbi"))
    assert list(private.rglob("*.nbi"))


@pytest.mark.slow
def test_old_versions_are_removed(copy: Path) -> None:
    cache = copy / "cache"
    called = copy / "reach_server" / "sets" / "kernels" / "planar.py"
    before = called.read_text()
    for version in range(KEPT_VERSIONS + 2):
        called.write_text(f"{before}# {version}\n")
        area(copy, FLEET_KERNEL_CACHE=str(cache))
    (own,) = (cache / "fleet-reach" / "kernels").glob("sets.polygon")
    assert len(list(own.iterdir())) == KEPT_VERSIONS


@pytest.mark.slow
def test_code_that_a_wheel_brings_is_used_as_long_as_its_sources_are_those(copy: Path) -> None:
    code = copy / "reach_server" / "numeric" / "machine_code"
    environment = {**os.environ, "PYTHONPATH": f"{copy}{os.pathsep}{ROOT}", "PYTHONDONTWRITEBYTECODE": "1"}
    command = [sys.executable, str(ROOT / ".ci" / "machine_code.py"), str(code), "reach_server.sets.polygon:_area_rows"]
    done = subprocess.run(command, cwd=copy, env=environment, capture_output=True, text=True, check=True)
    assert "machine code of 1 kernels for x86-64-v3" in done.stdout
    cache, nowhere = str(copy / "cache"), str(copy / "reach_server" / "py.typed")
    # A processor without the baseline compiles, as everybody did before.
    misses = 0 if usable_here() else 1
    assert area(copy, FLEET_KERNEL_CACHE=cache)[:2] == (4.0, misses)
    assert area(copy, FLEET_KERNEL_CACHE=cache, FLEET_SHIPPED_CODE="0")[:2] == (4.0, 1)
    value, compiled, _ = area(copy, FLEET_KERNEL_CACHE=nowhere, HOME=nowhere, XDG_CACHE_HOME=nowhere)
    assert (value, compiled) == (4.0, 0) if misses == 0 else value == 4.0
    called = copy / "reach_server" / "sets" / "kernels" / "planar.py"
    called.write_text(called.read_text().replace("    return 4.0 * total\n", "    return 400.0 * total\n", 1))
    assert area(copy, FLEET_KERNEL_CACHE=cache)[:2] == (400.0, 1)


def usable_here() -> bool:
    found = llvm.get_host_cpu_features()
    return platform.machine() == "x86_64" and all(found.get(feature, False) for feature in FEATURES)
