"""Statements, formulas and references are numbered, and every number that is named exists."""

import importlib.util
import re
from types import ModuleType

import pytest

from tests.docs.test_docs import DOCS, PACKAGES, PAGES, REFERENCE, ROOT, blocks, page, section

STATEMENT = re.compile(r"^\*\*(\d\.\d+)\b([^*]*)\*\*", re.M)
KINDS = ("exact", "outer", "calibrated", "hypothesis")


def hook(name: str = "link_references") -> ModuleType:
    spec = importlib.util.spec_from_file_location(name, DOCS / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def statements() -> list[tuple[int, int]]:
    found = [tuple(map(int, number.split("."))) for number, _ in STATEMENT.findall(page("mathematics.md"))]
    return [(section, place) for section, place in found]


def test_statements_are_numbered_one_after_the_other() -> None:
    numbers = statements()
    assert len(numbers) > 50
    for before, number in zip([(0, 0), *numbers], numbers, strict=False):
        assert number in ((before[0], before[1] + 1), (before[0] + 1, 1)), number


def test_formulas_are_numbered_one_after_the_other() -> None:
    text = page("mathematics.md")
    shown = "".join(blocks(DOCS / "mathematics.md", "math"))
    numbers = [int(number) for number in re.findall(r"\\tag\{(\d+)\}", shown)]
    assert numbers == list(range(1, len(numbers) + 1))
    assert len(numbers) > 20
    named = {int(number) for number in re.findall(r"(?<![\w\])|])\((\d+)\)", text)}
    assert named <= set(numbers)


def test_every_statement_has_a_place_in_the_code() -> None:
    below = section(page("mathematics.md"), "Where it is in the code")
    listed: list[tuple[int, int]] = []
    for row in re.findall(r"^\| (\d.*) \|$", below, re.M):
        numbers, _, modules = row.partition(" | ")
        for number in numbers.split(", "):
            first, second = number.split(".")
            listed.append((int(first), int(second)))
        for module in re.findall(r"`([\w/]+)`", modules):
            whole = module if module.partition("/")[0] in PACKAGES else f"reach_server/{module}"
            assert (ROOT / f"{whole}.py").is_file() or (ROOT / whole / "__init__.py").is_file(), module
    assert sorted(listed) == sorted(statements())


def test_statements_that_are_named_elsewhere_exist() -> None:
    known = {f"{first}.{second}" for first, second in statements()}
    sources = [path for package in PACKAGES for path in (ROOT / package).rglob("*.py")]
    named = set()
    for path in (*sources, *PAGES):
        text = " ".join(path.read_text(encoding="utf-8").split())
        for numbers in re.findall(r"mathematics(?:\.md[^)]*)?[,)]* \(?((?:\d\.\d+(?: to | and |, )?)+)", text):
            named |= set(re.findall(r"\d\.\d+", numbers))
        named |= set(re.findall(r"\[(\d\.\d+)\]\([^)]*mathematics\.md", text))
    assert len(named) > 5
    assert named <= known, named - known


def test_references_are_numbered_in_order_and_complete() -> None:
    text = page("references.md")
    keys = REFERENCE.findall(text)
    assert keys == sorted(keys, key=str.lower)
    entries = re.findall(r"^(\d+)\. (.*?)(?=^\d+\. |\Z)", text, re.M | re.S)
    assert [int(number) for number, _ in entries] == list(range(1, len(keys) + 1))
    anchor = hook().anchor
    for key, (_, entry) in zip(keys, entries, strict=True):
        entry = " ".join(entry.split())
        # Authors, title, and where and when it came out.
        year = key[-2:]
        assert re.match(rf"\*\*\[.*\]\*\*{{: #{anchor(key)} }} \w.*\. \*[^*]+\.\* .*\b(19|20){year}\b", entry), key


@pytest.mark.parametrize(
    ("html", "wanted"),
    [
        ("as [AJS+22] has it", 'as [<a href="r.html#AJS22">AJS+22</a>] has it'),
        ("[SDB+16, eq. 24]", '[<a href="r.html#SDB16">SDB+16</a>, eq. 24]'),
        ("[ABC05, ABC06]", '[<a href="r.html#ABC05">ABC05</a>, <a href="r.html#ABC06">ABC06</a>]'),
        ("<code>[AJS+22]</code> [a] [1] [T10a]", "<code>[AJS+22]</code> [a] [1] [T10a]"),
        ('<a href="#">[AJS+22]</a>', '<a href="#">[AJS+22]</a>'),
    ],
)
def test_keys_lead_to_their_reference(html: str, wanted: str) -> None:
    assert hook().linked(html, "r.html") == wanted
