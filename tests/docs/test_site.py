"""The site as a browser shows it from the disk: formulas, what does not fit, search, and nothing from elsewhere."""

import os
import re
import shutil
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.docs.test_docs import PAGES, ROOT, blocks
from tests.docs.test_mathematics import hook

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
#: The width of a small notebook and that of a common screen.
WIDTHS = (1280, 1920)
FORMULAS = [(path, source) for path in PAGES for source in blocks(path, "math")]
#: What is wider than its place and has to be scrolled to be seen.
SCROLLED = """() => [...document.querySelectorAll(".md-content *")]
    .filter((e) => e.scrollWidth > e.clientWidth + 1 && ["auto", "scroll"].includes(getComputedStyle(e).overflowX))
    .map((e) => e.textContent.slice(0, 80))"""
#: Edges of what is shown of formulas and their numbers, and of the column that they stand in.
EDGES = """() => {
  const column = document.querySelector(".md-content__inner").getBoundingClientRect();
  const box = (e) => { const r = e.getBoundingClientRect(); return [r.left, r.right, r.height]; };
  const formulas = [...document.querySelectorAll(".formula")];
  return {
    column: [column.left, column.right],
    formulas: formulas.map((e) => box(e.querySelector("math"))),
    numbers: formulas.map((e) => e.querySelector(".number")).filter(Boolean).map((e) => [e.textContent, ...box(e)]),
  };
}"""


@pytest.mark.parametrize("source", [source for _, source in FORMULAS], ids=[str(k) for k in range(len(FORMULAS))])
def test_every_formula_is_set(source: str) -> None:
    code, number = hook("formulas").mathml(source)
    assert re.fullmatch(r'<math xmlns="http://www.w3.org/1998/Math/MathML" display="block">.*</math>', code)
    assert (f"\\tag{{{number}}}" in source) == bool(number)
    # Letters and digits that are written are shown; those of the names of commands are not.
    written = re.sub(r"\\(?:begin|end)\{[^}]*\}|\\tag\{\d+\}|\\[a-zA-Z]+|[\W_]", "", source)
    shown = re.sub(r"<[^>]*>|&#x\w+;|&nbsp;", "", code)
    assert not Counter(written) - Counter(shown)


@pytest.mark.parametrize(
    "source", [r"a \begin{aligned} b & c \end{aligned}", r"\nosuch x", r"\mathcal N", r"a \tag{1} \tag{2}"]
)
def test_what_would_not_be_seen_as_it_is_meant_is_refused(source: str) -> None:
    with pytest.raises(ValueError, match=r"cannot be set|one number"):
        hook("formulas").mathml(source)


@pytest.mark.parametrize(
    ("html", "wanted"),
    [
        ("|r_ji - r_ki| ≤ 2w_i", "|r<sub>ji</sub> - r<sub>ki</sub>| ≤ 2w<sub>i</sub>"),
        ("v⁺_p, R_{k+1}, x in R^n", "v⁺<sub>p</sub>, R<sub>k+1</sub>, x in R<sup>n</sup>"),
        ("d^h_k, |g|_∞", "d<sup>h</sup><sub>k</sub>, |g|<sub>∞</sub>"),
        ("Σ_{i&lt;j} g_i", "Σ<sub>i&lt;j</sub> g<sub>i</sub>"),
        ('<a id="a_b">x_i</a> <code>a_b</code>', '<a id="a_b">x<sub>i</sub></a> <code>a_b</code>'),
        ("<math><mi>a_b</mi></math> _x", "<math><mi>a_b</mi></math> _x"),
    ],
)
def test_indices_in_the_text_are_lowered(html: str, wanted: str) -> None:
    assert hook("formulas").with_indices(html) == wanted


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The pages as ``make docs`` builds them."""
    target = tmp_path_factory.mktemp("site")
    words = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(target)]
    environment = {**os.environ, "NO_MKDOCS_2_WARNING": "1"}
    done = subprocess.run(words, check=False, cwd=ROOT, env=environment, capture_output=True, text=True, timeout=500)
    assert done.returncode == 0, done.stderr
    return target


@pytest.mark.slow
@pytest.mark.integration
def test_nothing_is_loaded_from_elsewhere(site: Path) -> None:
    for path in site.rglob("*.html"):
        for element in re.findall(r"<(?:script|link|img|iframe)\b[^>]*>", path.read_text(encoding="utf-8")):
            assert not re.search(r"""\bsrc=["']?(?:https?:)?//""", element), (path.name, element)
            assert "stylesheet" not in element or "//" not in element, (path.name, element)


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    if CHROMIUM is None:
        pytest.skip("needs chromium, to see the pages as a browser shows them")
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        running = playwright.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        yield running
        running.close()


def opened(browser: Any, path: Path, width: int) -> tuple[Any, list[str]]:
    """A page from the disk, and the list to which it adds each address elsewhere that it asks for, and its errors."""
    page = browser.new_page(viewport={"width": width, "height": 900})
    wrong: list[str] = []
    page.on("request", lambda r: None if r.url.startswith(("file:", "data:", "blob:")) else wrong.append(r.url))
    page.on("pageerror", lambda error: wrong.append(str(error)))
    page.goto(path.as_uri())
    return page, wrong


@pytest.mark.slow
@pytest.mark.integration
@pytest.mark.parametrize("width", WIDTHS)
def test_every_formula_and_its_number_is_seen_whole(site: Path, browser: Any, width: int) -> None:
    page, wrong = opened(browser, site / "mathematics.html", width)
    assert page.evaluate(SCROLLED) == []
    edges = page.evaluate(EDGES)
    left, right = edges["column"]
    assert len(edges["formulas"]) == sum(path.name == "mathematics.md" for path, _ in FORMULAS)
    assert all(left <= a < b <= right and height > 0 for a, b, height in edges["formulas"])
    assert [number for number, *_ in edges["numbers"]] == [f"({k + 1})" for k in range(len(edges["numbers"]))]
    assert len(edges["numbers"]) == sum("\\tag" in source for _, source in FORMULAS)
    # At the right edge, in one line.
    assert all(right - 40 < b <= right and height < 40 for _, _, b, height in edges["numbers"])
    assert wrong == []
    page.close()


@pytest.mark.slow
@pytest.mark.integration
@pytest.mark.parametrize("name", ["index.html", "concepts/architecture.html"])
def test_diagrams_are_not_cut(site: Path, browser: Any, name: str) -> None:
    page, _ = opened(browser, site / name, WIDTHS[0])
    assert page.evaluate(SCROLLED) == []
    page.close()


@pytest.mark.slow
@pytest.mark.integration
@pytest.mark.parametrize("start", ["index.html", "how-to/profile.html"])
def test_search_works_from_the_disk(site: Path, browser: Any, start: str) -> None:
    page, wrong = opened(browser, site / start, WIDTHS[0])
    field = page.locator("[data-md-component=search-query]")
    field.click()
    field.press_sequentially("covering radius")
    page.wait_for_selector(".md-search-result__item", timeout=60_000)
    found = page.eval_on_selector_all(".md-search-result__link", "links => links.map(link => link.href)")
    assert any("mathematics.html" in link for link in found), found
    assert wrong == []
    page.close()
