"""The page on installing names what pyproject.toml, the sources and deploy/ ask for."""

import re
import tomllib
from typing import Any

import pytest

from tests.docs.test_docs import PACKAGES, ROOT, page, section

TEXT = page("install.md")
PROJECT: dict[str, Any] = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
EXTRAS: dict[str, list[str]] = PROJECT["optional-dependencies"]
ROWS = dict(re.findall(r"^\| `(\w+)` \| ([^|]*) \|", section(TEXT, "What each role needs"), re.M))


def test_every_extra_has_its_row() -> None:
    assert set(ROWS) == set(EXTRAS)


@pytest.mark.parametrize("extra", sorted(set(EXTRAS) - {"dev"}))
def test_a_row_names_what_the_extra_adds(extra: str) -> None:
    wanted = {re.split(r"[\[>=;]", requirement)[0] for requirement in EXTRAS[extra]} - {PROJECT["name"]}
    assert wanted <= set(re.findall(r"[\w-]+", ROWS[extra]))


def test_the_oldest_python_and_the_wheel_are_those_of_the_project() -> None:
    assert f"Python {PROJECT['requires-python'].removeprefix('>=')} or newer" in TEXT
    assert f"dist/fleet_reach-{PROJECT['version']}-py3-none-any.whl" in TEXT


def read() -> set[str]:
    """Environment variables that something of the project reads or sets."""
    sources = [path for package in (*PACKAGES, "benchmarks") for path in (ROOT / package).rglob("*.py")]
    sources += [ROOT / "Makefile", ROOT / ".ci" / "install", ROOT / "tests" / "examples.py"]
    sources += (ROOT / "deploy" / "systemd").iterdir()
    text = "\n".join(path.read_text(encoding="utf-8") for path in sources)
    names = set(re.findall(r"environ(?:\.get)?[\[(]\s*\"(\w+)\"", text))
    return names | set(re.findall(r"\b(?:FLEET_[A-Z_]+|[A-Z]+_NUM_THREADS|PIP_[A-Z_]+)\b", text))


def test_every_variable_is_listed() -> None:
    listed = set(re.findall(r"`([A-Z][A-Z_]+)`", section(TEXT, "Environment variables")))
    assert len(read()) > 10
    assert read() | {"PYTHON", "ARGS"} <= listed
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    assert "$(PYTHON)" in makefile
    assert "$(ARGS)" in makefile
