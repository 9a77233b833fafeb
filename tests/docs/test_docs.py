"""The documentation keeps step with what it documents."""

import ast
import re
import sys
from pathlib import Path
from typing import Any

import pytest
import typer
import yaml

from fleet_bus import codec, keys
from fleet_bus.messages import (
    Assignment,
    Document,
    Event,
    EventKind,
    Label,
    ScenarioDocument,
    ServiceStatus,
    StateFlag,
    VehicleProfile,
    parse_profile,
)
from fleet_bus.messages.methods import FROM_LIMITS, METHODS, TUBE_METHODS
from fleet_bus.messages.state import MAX_BYTES as STATE_BYTES
from fleet_bus.messages.tube import MAX_BYTES as TUBE_BYTES
from fleet_bus.schemas.wire_page import rewritten
from fleet_cli.main import app

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
PACKAGES = (
    "fleet_bus",
    "fleet_cli",
    "fleet_dashboard",
    "fleet_foxglove",
    "fleet_lab",
    "fleet_recorder",
    "fleet_view",
    "reach_server",
    "side_info",
    "vehicle_agent",
)
PAGES = sorted(DOCS.rglob("*.md"))
KEY = re.compile(r"(?<![\w.])([A-Z][A-Za-z]*\+?\d\d)(?!\w)")
REFERENCE = re.compile(r"^\d+\. \*\*\[([^\]]+)\]\*\*", re.M)
#: Examples, and the guides that show them.
SHOWN = {
    "publish_state.py": "publish-states.md",
    "read_tube.py": "read-a-tube.md",
    "read_verdicts.py": "write-a-scenario.md",
}


def page(name: str) -> str:
    return (DOCS / name).read_text(encoding="utf-8")


def section(text: str, heading: str) -> str:
    """What stands below ``## heading``."""
    found = re.search(rf"^## {re.escape(heading)}\n(.*?)(?=^## |\Z)", text, re.M | re.S)
    assert found is not None, f"no section {heading!r}"
    return found[1]


def blocks(path: Path, language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```$", path.read_text(encoding="utf-8"), re.M | re.S)


def test_the_pages_are_those_of_the_navigation() -> None:
    def listed(entry: Any) -> list[str]:
        if isinstance(entry, str):
            return [entry]
        return [name for item in (entry if isinstance(entry, list) else entry.values()) for name in listed(item)]

    configuration = yaml.safe_load((ROOT / "mkdocs.yml").read_text(encoding="utf-8"))
    assert sorted(listed(configuration["nav"])) == [str(path.relative_to(DOCS)) for path in PAGES]


@pytest.mark.parametrize("path", PAGES, ids=[str(path.relative_to(DOCS)) for path in PAGES])
def test_relative_links_lead_to_files(path: Path) -> None:
    text = re.sub(r"^```.*?^```$|`[^`\n]*`", "", path.read_text(encoding="utf-8"), flags=re.M | re.S)
    for target in re.findall(r"\]\(([^)#\s]+)[^)]*\)", text):
        if not target.startswith("https://"):
            assert (path.parent / target).is_file(), target


def test_every_reference_key_in_use_is_listed() -> None:
    listed = set(REFERENCE.findall(page("references.md")))
    sources = [source for package in PACKAGES for source in (ROOT / package).rglob("*.py")]
    pages = [path for path in PAGES if path.name != "references.md"]
    used = {
        key
        for path in (*sources, *pages)
        for inside in re.findall(r"\[([^\[\]]+)\]", path.read_text(encoding="utf-8"))
        for key in KEY.findall(inside)
    }
    assert {"Gir05", "SDB+16", "VGS05"} <= used
    assert used <= listed, used - listed
    assert listed <= used, f"listed, but nowhere used: {listed - used}"


def commands() -> dict[str, Any]:
    """Full name to command, groups included."""
    found: dict[str, Any] = {}

    def walk(name: str, command: Any) -> None:
        found[name] = command
        for child, sub in getattr(command, "commands", {}).items():
            walk(f"{name} {child}", sub)

    walk("fleet", typer.main.get_command(app))
    return found


def options_of(command: Any) -> set[str]:
    every = {name for p in command.params for name in (*p.opts, *p.secondary_opts) if name.startswith("--")}
    return every - {"--help"}


def test_every_command_and_option_is_on_its_page_and_no_other() -> None:
    text = page("reference/command.md")
    found = commands()
    top = [name for name in found if name.count(" ") == 1]
    assert sorted(re.findall(r"^## (fleet \S+)$", text, re.M)) == sorted(top)
    for name in top:
        below = section(text, name)
        wanted = {
            o for other, command in found.items() if f"{other} ".startswith(f"{name} ") for o in options_of(command)
        }
        listed = {o for row in re.findall(r"^\| (`--[^|]*) \|", below, re.M) for o in re.findall(r"`(--[\w-]+)`", row)}
        assert listed == wanted, name
        for other in found:
            if other.startswith(f"{name} "):
                assert f"`{other}" in below, other
    head = text.partition("\n## ")[0]
    assert all(f"`{option}`" in head for option in options_of(found["fleet"]))


def test_every_key_encoding_and_reason_is_on_the_wire_page() -> None:
    text = page("reference/wire.md")
    for key in (
        keys.state("v"), keys.truth("v"), keys.profile("v"), keys.alive("v"), keys.tube("v"), keys.event("v"),
        keys.document("s"), keys.assignment("s", "v"), keys.service("k", "i"), keys.service_status("k", "i"),
        keys.service_event("k", "i"),
    ):  # fmt: skip
        shown = key.replace("spec/s", "spec/<scenario>").replace("svc/k/i", "svc/<kind>/<instance>")
        shown = re.sub(r"/v(/|$)", r"/<vehicle>\1", shown)
        assert f"| `{shown}` |" in text, shown
    reasons = section(text, "Reasons of refusal")
    assert re.findall(r"^\| `(\w+)` \|", reasons, re.M) == list(codec.REASONS)
    kinds = section(text, "Event")
    assert set(EventKind) <= set(re.findall(r"^\| `(\w+)` \|", kinds, re.M))
    limits = {cls.SCHEMA: cls.MAX_BYTES for cls in DOCUMENTS} | {"fleet.state": STATE_BYTES, "fleet.tube": TUBE_BYTES}
    for schema, limit in limits.items():
        assert f"| `{schema}` v1 | {limit:,} |".replace(",", " ") in text
    for number in (codec.MAX_LIST, codec.MAX_MAP, codec.MAX_DEPTH):
        assert f"{number:,}".replace(",", " ") in section(text, "Encoding")


DOCUMENTS: tuple[type[Document], ...] = (VehicleProfile, ScenarioDocument, Assignment, Event, ServiceStatus)


@pytest.mark.parametrize("cls", DOCUMENTS)
def test_every_field_of_a_document_is_on_the_wire_page(cls: type[Document]) -> None:
    below = section(page("reference/wire.md"), cls.__name__)
    listed = re.findall(r"^\| `(\w+)` \| [^|]*\|[^|]*\|", below.partition("| kind |")[0], re.M)
    assert listed == [info.alias or name for name, info in cls.model_fields.items()]


def test_the_tables_of_the_wire_page_follow_from_the_lists_of_fields() -> None:
    text = page("reference/wire.md")
    assert rewritten(text) == text, "run python -m fleet_bus.schemas"
    assert rewritten(text.replace("| sum of 1 input", "| the 1 input")) == text
    with pytest.raises(ValueError, match=r"0 tables '\| key \| name"):
        rewritten(text.replace("| key | name |", "| field | name |"))


def test_every_flag_of_a_state_and_label_of_a_tube_is_on_the_wire_page() -> None:
    flags = re.findall(r"^\| (\d+) \| `([A-Z_]+)` \|", section(page("reference/wire.md"), "StateSample"), re.M)
    assert [(int(value), name) for value, name in flags] == [(flag.value, flag.name) for flag in StateFlag if flag]
    below = section(page("reference/wire.md"), "ReachTube")
    assert all(f"`{label}`" in below for label in Label)
    (methods,) = re.findall(r"^\| `m` \| method \| (.+?) \|", below, re.M)
    assert re.findall(r"`(\w+)`", methods) == list(TUBE_METHODS)


def test_every_list_of_methods_is_that_of_the_program() -> None:
    """What a profile may ask for, what the command takes, what the server makes: one list, in one order."""
    assert (*METHODS, FROM_LIMITS) == TUBE_METHODS
    asked = ["default", *METHODS]
    profile = section(page("reference/wire.md"), "VehicleProfile")
    (row,) = re.findall(r"^\| `method` \| ([^|]+) \| `default` \|", profile, re.M)
    assert re.findall(r"`(\w+)`", row) == asked
    assert VehicleProfile.json_schema()["properties"]["method"]["enum"] == asked
    below = section(page("reference/command.md"), "fleet evaluate")
    (row,) = re.findall(r"^\| `--method` \| [^|]+ \| [^|:]+: ([^|]+) \|", below, re.M)
    assert re.findall(r"`(\w+)`", row) == asked
    assert all(f"`{method}`" in page("concepts/guarantees.md") for method in METHODS)


def test_the_labels_are_explained() -> None:
    text = page("concepts/guarantees.md")
    assert re.findall(r"^\| `(\w+)` \|", text, re.M) == [str(label) for label in Label]


RUNNABLE = [path for path in PAGES if blocks(path, "python")]


@pytest.mark.parametrize("path", RUNNABLE, ids=[path.stem for path in RUNNABLE])
def test_python_blocks_run_one_after_the_other(path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    names: dict[str, Any] = {"__name__": "docs"}
    for number, block in enumerate(blocks(path, "python")):
        exec(compile(block, f"{path.name}, block {number}", "exec"), names)


def test_the_profile_of_the_guide_is_one_and_fits_its_recording(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from vehicle_agent.recording import load_recording

    guide = DOCS / "how-to" / "own-recording.md"
    (text,) = blocks(guide, "yaml")
    profile = parse_profile(yaml.safe_load(text), guide.name)
    monkeypatch.chdir(tmp_path)
    exec(blocks(guide, "python")[0], {})
    selected = load_recording(tmp_path / "mycar.npz").select(profile)
    assert selected.state_names == profile.state_names


@pytest.mark.parametrize(("example", "guide"), SHOWN.items())
def test_the_guide_shows_the_whole_example(example: str, guide: str) -> None:
    text = (DOCS / "examples" / example).read_text(encoding="utf-8")
    assert text in blocks(DOCS / "how-to" / guide, "python")


@pytest.mark.parametrize("path", sorted((DOCS / "examples").glob("*.py")), ids=lambda path: path.stem)
def test_the_examples_know_nothing_of_this_project(path: Path) -> None:
    imported = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            imported |= {alias.name.partition(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0
            imported.add((node.module or "").partition(".")[0])
    assert imported - sys.stdlib_module_names == {"msgpack", "zenoh"}
