"""How the tests run: the same examples each time, others in a campaign, and kernels that are compiled before."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PROPERTY = """
from hypothesis import given, strategies as st
from tests.examples import examples, generator, seed

def test_drawn():
    print("numbers", seed(5), examples(7), generator("a", 1).integers(0, 10**9))

@given(st.integers(0, 10**9))
def test_property(number):
    print("drew", number)
"""


def run(folder: Path, text: str, *arguments: str, **asked: str) -> str:
    """What pytest says of one file of tests beside the conftest of all."""
    (folder / "conftest.py").write_text("from tests.conftest import *\n")
    (folder / "test_it.py").write_text(text)
    environment = {key: value for key, value in os.environ.items() if not key.startswith("FLEET_TEST_")}
    environment |= {"PYTHONPATH": f"{ROOT}{os.pathsep}{os.environ.get('PYTHONPATH', '')}", **asked}
    command = [sys.executable, "-m", "pytest", "-c", str(ROOT / "pyproject.toml"), "--rootdir", str(folder)]
    done = subprocess.run(
        [*command, "-p", "no:cacheprovider", "-rP", *arguments, str(folder)],
        cwd=folder,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    return done.stdout + done.stderr


def drawn(said: str) -> list[str]:
    return re.findall(r"^(?:drew|numbers) .*", said, re.M)


def test_examples_are_the_same_in_every_run_and_others_in_a_campaign(tmp_path: Path) -> None:
    usual = drawn(run(tmp_path, PROPERTY))
    assert len(usual) == 101
    assert usual[0].startswith("numbers 5 7 ")
    assert usual == drawn(run(tmp_path, PROPERTY))
    asked = drawn(run(tmp_path, PROPERTY, FLEET_TEST_SEED="3", FLEET_TEST_EXAMPLES="250"))
    assert len(asked) == 251
    assert asked[0].startswith("numbers 3 250 ")
    assert asked == drawn(run(tmp_path, PROPERTY, FLEET_TEST_SEED="3", FLEET_TEST_EXAMPLES="250"))
    assert asked[1:] != drawn(run(tmp_path, PROPERTY, FLEET_TEST_SEED="4", FLEET_TEST_EXAMPLES="250"))[1:]


def test_a_fresh_seed_is_said_and_repeats_what_fails(tmp_path: Path) -> None:
    failing = PROPERTY.replace('print("drew", number)', "assert number < 10**8")
    said = run(tmp_path, failing, "-m", "property", FLEET_TEST_SEED="fresh")
    (seed,) = set(re.findall(r"FLEET_TEST_SEED=(\d+)", said))
    again = run(tmp_path, failing, "-m", "property", FLEET_TEST_SEED=seed)
    assert f"FLEET_TEST_SEED={seed} {sys.executable} -m pytest test_it.py::test_property" in said
    assert "1 failed, 1 deselected" in said
    examples = [re.findall(r"number=(\d+)", one) for one in (said, again)]
    assert examples[0] == examples[1]


@pytest.mark.parametrize(("name", "wrong"), [("SEED", "soon"), ("SEED", "-1"), ("EXAMPLES", "0"), ("EXAMPLES", "1e5")])
def test_a_number_that_is_none_is_refused(tmp_path: Path, name: str, wrong: str) -> None:
    assert f"FLEET_TEST_{name} is '{wrong}', expected" in run(tmp_path, PROPERTY, **{f"FLEET_TEST_{name}": wrong})


def test_kernels_are_compiled_before_the_tests_that_need_them_and_for_no_others(tmp_path: Path) -> None:
    said = run(tmp_path, "import reach_server.numeric.jit\ndef test_nothing(): pass\n")
    assert re.search(r"making kernels ready.*\n.*kernels took .* s\n", said)
    assert "1 passed" in said
    assert "kernels took" not in run(tmp_path, "def test_nothing(): pass\n")


def test_workers_find_kernels_compiled_and_what_runs_in_real_time_stays_together(tmp_path: Path) -> None:
    pytest.importorskip("xdist")
    text = """
import os, pytest
import reach_server.numeric.jit

@pytest.mark.integration
@pytest.mark.parametrize("number", range(4))
def test_real_time(number):
    print("real time in", os.environ["PYTEST_XDIST_WORKER"])

def test_first(): print("others in", os.environ["PYTEST_XDIST_WORKER"])
def test_second(): print("others in", os.environ["PYTEST_XDIST_WORKER"])
"""
    (tmp_path / "test_other.py").write_text(text)
    said = run(tmp_path, text, "-n", "2", "--dist", "loadfile", "--no-loadscope-reorder")
    assert said.count("kernels took") == 1
    assert "12 passed" in said.splitlines()[-1]
    found = re.findall(r"^real time in (gw\d)$", said, re.M)
    assert len(found) == 8
    assert len(set(found)) == 1
    assert len(re.findall(r"^others in gw\d$", said, re.M)) == 4
