"""What is not Python on the pages and in README: commands parse, documents load, JSON has the keys that are written."""

import json
import re
import shlex
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import typer
import yaml

from fleet_bus.messages import parse_profile
from fleet_cli.main import app
from side_info import Scenario
from tests.docs.test_docs import DOCS, PAGES, ROOT, blocks, commands, options_of, page, section
from vehicle_agent.route import Route

TEXTS = [ROOT / "README.md", *PAGES]
FLEET = typer.main.get_command(app)
#: What a command line that cannot be raises: the base of all such errors.
REFUSED = typer.BadParameter.__mro__[1]
TARGETS = set(re.findall(r"^([\w-]+):(?!=)", (ROOT / "Makefile").read_text(encoding="utf-8"), re.M))
#: Targets of make that hand ARGS to a command, and to which.
HANDED_ON = {"demo": ["demo"], "bench": ["bench"]}


def shown(path: Path) -> list[str]:
    """Lines that a reader is to type: those of ``sh`` blocks, and after ``$`` in ``console`` blocks, at any indent."""
    text = path.read_text(encoding="utf-8")
    lines = []
    for indent, language, block in re.findall(r"^( *)```(sh|console)\n(.*?)^\1```$", text, re.M | re.S):
        for line in block.splitlines():
            line = line.removeprefix(indent)
            if language == "sh" and line:
                lines.append(line)
            elif line.startswith("$ "):
                lines.append(line.removeprefix("$ "))
    return lines


def spans(path: Path) -> list[str]:
    """Commands inside of sentences."""
    text = re.sub(r"^ *```.*?^ *```$", "", path.read_text(encoding="utf-8"), flags=re.M | re.S)
    return [" ".join(span.split()) for span in re.findall(r"`((?:\.venv/bin/)?(?:fleet|make) [^`]+)`", text)]


def every(kind: Callable[[Path], list[str]]) -> list[Any]:
    return [pytest.param(line, id=f"{path.name}: {line[:60]}") for path in TEXTS for line in kind(path)]


def check_fleet(words: list[str]) -> None:
    """Parse the words after ``fleet`` as the command does; nothing is run."""
    if "--help" in words:
        words = [word for word in words if word != "--help"]
        if not words:
            return
    context = FLEET.make_context("fleet", list(words))
    command: Any = FLEET
    rest = [*context._protected_args, *context.args]
    # A group may be a command itself.
    while rest and hasattr(command, "resolve_command"):
        name, command, rest = command.resolve_command(context, rest)
        assert command is not None, words
        context = command.make_context(name, list(rest), parent=context)
        rest = [*context._protected_args, *context.args]
    assert not rest, words


def check(line: str) -> None:
    words = shlex.split(line, comments=True)
    program = words[0].removeprefix(".venv/bin/")
    if program == "fleet":
        check_fleet(words[1:])
    elif program == "make":
        targets = [word for word in words[1:] if "=" not in word]
        assert targets
        assert set(targets) <= TARGETS
        handed = [word.removeprefix("ARGS=") for word in words if word.startswith("ARGS=")]
        for target in targets:
            if handed and target in HANDED_ON:
                check_fleet([*HANDED_ON[target], *shlex.split(handed[0])])
    elif words[:2] == ["python", "-m"]:
        assert any((ROOT / words[2]).glob("__main__.py")), line
    elif program == "python":
        example = (ROOT / words[1]).read_text(encoding="utf-8")
        assert all(f'"{word}"' in example for word in words if word.startswith("--")), line
    else:
        assert program in ("export", "pip"), f"{line}: check what this is"


@pytest.mark.parametrize("line", every(shown))
def test_a_command_that_is_shown_can_be_typed(line: str) -> None:
    check(line)


def check_span(line: str) -> None:
    """Check a command in a sentence: its name and options, and where nothing is left open all of it."""
    words = shlex.split(line)
    if not re.search(r"…|\b[A-Z]{4,}\b(?!=)", line) and (len(words) > 3 or words[0] == "make"):
        check(line)
    else:
        check_names(line)


def check_names(line: str) -> None:
    """Check the name of a command and of its options. Words in capitals stand for something, the rest is left out."""
    words = shlex.split(line)
    found = commands()
    name = next((n for n in (" ".join(words[:k]) for k in (3, 2)) if n in found), "fleet")
    assert name != "fleet" or words[1:] in (["--help"], ["COMMAND", "--help"], ["…"]), line
    assert {word for word in words if word.startswith("--")} - {"--help"} <= options_of(found[name]), line


@pytest.mark.parametrize("line", every(spans))
def test_a_command_inside_of_a_sentence_exists(line: str) -> None:
    check_span(line)


def test_the_checks_can_fail() -> None:
    for line in ("fleet evaluate --profile", "fleet reach --idd x", "make dmeo", "make demo ARGS=--vehicles", "rm x"):
        with pytest.raises((AssertionError, REFUSED)):
            check(line)


@pytest.mark.parametrize("path", [p for p in PAGES if blocks(p, "yaml")], ids=lambda path: str(path.name))
def test_documents_on_the_pages_load(path: Path) -> None:
    for text in blocks(path, "yaml"):
        fields = yaml.safe_load(text)
        if "class" in fields:
            parse_profile(fields, path.name)
        elif "route" in fields:
            Route.model_validate(fields)
        else:
            Scenario.parse(text, path.name)


@pytest.mark.parametrize("path", sorted(DOCS.rglob("*.md")), ids=lambda path: str(path.name))
def test_json_on_the_pages_is_json(path: Path) -> None:
    for text in blocks(path, "json"):
        json.loads(text)


@pytest.mark.slow
def test_the_document_of_evaluate_has_the_keys_on_its_page(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from fleet_lab.evaluation import Settings, as_json, evaluate, plan_trials
    from vehicle_agent.recording import load_recording

    guide = DOCS / "how-to" / "own-recording.md"
    (profile_text,) = blocks(guide, "yaml")
    profile = parse_profile(yaml.safe_load(profile_text), guide.name)
    monkeypatch.chdir(tmp_path)
    exec(blocks(guide, "python")[0], {})
    recording = load_recording(tmp_path / "mycar.npz")
    settings = Settings(methods=("calibrated",), horizon=10, inputs="recorded", frozen=False)
    figures = evaluate(plan_trials([recording], profile), profile, settings)
    written = json.loads(json.dumps(as_json(figures, ["mycar.npz"], profile, 10)))
    (example,) = (json.loads(text) for text in re.findall(r"```json\n(.*?)```", page_of_evaluate(), re.S))

    def compare(shown: Any, there: Any, place: str) -> None:
        if isinstance(shown, dict):
            free = place.endswith(("label_counts", "waiting", "rolling.steps"))
            assert free or set(shown) == set(there), place
            for key in set(shown) & set(there):
                compare(shown[key], there[key], f"{place}.{key}")
        elif isinstance(shown, list) and there and isinstance(shown[0], dict):
            compare(shown[0], there[0], place)

    compare(example, written, "document")


def page_of_evaluate() -> str:
    return section(page("reference/command.md"), "fleet evaluate")
