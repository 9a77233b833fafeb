"""What deploy/, the pages and the sources say can be typed or subscribed to exists in the program."""

import ast
import re
from pathlib import Path

import pytest

from fleet_bus import keys
from tests.deploy.units import DEPLOY, ROOT
from tests.docs.test_blocks import TEXTS, check_names, check_span
from tests.docs.test_docs import DOCS, PACKAGES

FILES = sorted(path for path in DEPLOY.rglob("*") if path.is_file())
PAGES = [*TEXTS, ROOT / "CHANGELOG.md"]
SOURCES = sorted(path for package in (*PACKAGES, "benchmarks") for path in (ROOT / package).rglob("*.py"))

#: Every key of the bus, a placeholder for each id.
ID = "<id>"
_SHOWN = "placeholder"
FAMILIES = [
    key.replace(_SHOWN, ID)
    for key in (
        keys.state(_SHOWN), keys.truth(_SHOWN), keys.profile(_SHOWN), keys.alive(_SHOWN), keys.tube(_SHOWN),
        keys.event(_SHOWN), keys.document(_SHOWN), keys.assignment(_SHOWN, _SHOWN), keys.service(_SHOWN, _SHOWN),
        keys.service_status(_SHOWN, _SHOWN), keys.service_event(_SHOWN, _SHOWN),
    )
]  # fmt: skip
ROLES = "|".join(sorted({family.partition("/")[0] for family in FAMILIES}))
CHUNK = r"(?:<[\w-]+>|\{[\w.]+\}|[\w.*@-]+)"
KEY = re.compile(rf"(?<![\w./-])(?:{ROLES})/(?:{CHUNK}(?:/{CHUNK})*/?)?")
#: What stands for all keys of a role.
NO_KEYS = re.compile(r"(?:fleet|spec|reach|svc)/")


def stands_for(shown: str, family: str) -> bool:
    """Whether a key expression as it is written stands for keys of a family: ``*`` and ``**`` as in Zenoh, ``…/`` as
    what they begin with."""
    chunks, wanted = shown.split("/"), family.split("/")
    # Below a key are the caches of those who put on it.
    if "@adv" in chunks:
        chunks = chunks[: chunks.index("@adv")]
    if chunks[-1] in ("**", ""):
        return len(chunks) <= len(wanted) + 1 and all(map(chunk_fits, chunks[:-1], wanted))
    return len(chunks) == len(wanted) and all(map(chunk_fits, chunks, wanted))


def chunk_fits(chunk: str, wanted: str) -> bool:
    variable = chunk == "*" or re.fullmatch(r"<[\w-]+>|\{[\w.]+\}", chunk) is not None
    if wanted == ID:
        return variable or keys.ID_PATTERN.fullmatch(chunk) is not None
    return chunk in (wanted, "*")


def shown_keys(text: str) -> set[str]:
    """Keys and key expressions in a text; ``spec/`` alone, all that is below it, is none."""
    return {key for key in KEY.findall(text) if not NO_KEYS.fullmatch(key)}


def spans(text: str) -> set[str]:
    return {" ".join(span.split()) for span in re.findall(r"`(fleet [^`]+)`", text)}


def texts_of(path: Path) -> list[str]:
    """Docstrings and other literal text of a module; what an f-string fills in is left open."""
    found = []
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.JoinedStr):
            parts = [value.value if isinstance(value, ast.Constant) else "…" for value in node.values]
            found.append("".join(map(str, parts)))
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            found.append(node.value)
    return found


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.name)
def test_commands_in_the_files_of_a_deployment_exist(path: Path) -> None:
    for line in spans(path.read_text(encoding="utf-8")):
        check_span(line)


@pytest.mark.slow
def test_commands_in_docstrings_and_messages_exist() -> None:
    found = {span for path in SOURCES for text in texts_of(path) for span in spans(text)}
    assert len(found) > 5
    for line in found:
        check_names(line)


@pytest.mark.parametrize("path", [*FILES, *PAGES, *sorted(DOCS.rglob("*.py"))], ids=lambda path: path.name)
def test_keys_that_are_shown_exist(path: Path) -> None:
    for key in shown_keys(path.read_text(encoding="utf-8")):
        assert any(stands_for(key, family) for family in FAMILIES), f"{path.name}: {key}"


@pytest.mark.slow
def test_keys_in_docstrings_and_messages_exist() -> None:
    found = {key for path in SOURCES for text in texts_of(path) for key in shown_keys(text)}
    assert len(found) > 5
    for key in found:
        assert any(stands_for(key, family) for family in FAMILIES), key


def test_what_does_not_exist_is_promised_nowhere() -> None:
    """Words that the checks above cannot read as commands or keys; take one out when it has come true."""
    absent = re.compile(
        r"\bros2\b|rosbag|--cluster|--registry|share the vehicles|router config --"
        r"|fleet (?:doctor|dashboard|certs)\b",
        re.IGNORECASE,
    )
    for path in [*FILES, *PAGES, *SOURCES]:
        assert absent.findall(path.read_text(encoding="utf-8")) == [], path


def test_the_checks_can_fail() -> None:
    for line in (
        "fleet doctor",
        "fleet router config --registry FILE",
        "fleet agent --source ros2 --vehicle a --no-such",
    ):
        with pytest.raises(AssertionError):
            check_names(line)
    for key in (
        "reach/*/outline",
        "reach/<vehicle>/full",
        "fleet/car",
        "spec/<scenario>",
        "svc/reach/a/b/",
        "svc/reach/a/state",
    ):
        assert shown_keys(f"on `{key}` comes")
        assert not any(stands_for(key, family) for family in FAMILIES), key
    for key in (
        "fleet/*/state",
        "reach/{options.vehicle}/*",
        "spec/**",
        "svc/reach/<id>/status",
        "fleet/a/state/@adv/**",
    ):
        assert shown_keys(f'"{key}"') == {key}
        assert any(stands_for(key, family) for family in FAMILIES), key


@pytest.mark.parametrize("path", [*FILES, *PAGES], ids=lambda path: path.name)
def test_sources_of_agents_exist(path: Path) -> None:
    shown = re.findall(r"--source (\w+)", path.read_text(encoding="utf-8"))
    # Those are named in the error of an unknown one, which another test reads.
    assert set(shown) <= {"sim", "recording"}
