"""A hook of MkDocs: keys in square brackets, as [AJS+22] or [SDB+16, eq. 24], lead to the page of references.

It works on the finished HTML, so that keys in docstrings are linked as those on the pages are.
"""

import re
from typing import Any

KEY = re.compile(r"[A-Z][A-Za-z]*\+?\d\d(?!\w)")
BRACKETS = re.compile(rf"\[(?={KEY.pattern})[^\[\]<>]*\]")
#: What is left as it is: code, and what is a link already.
LEFT_ALONE = re.compile(r"(<(pre|code|a)\b.*?</\2>)", re.S)
TARGET = "references.md"


def anchor(key: str) -> str:
    """The id of a reference on its page."""
    return key.replace("+", "")


def linked(html: str, page: str) -> str:
    """``html`` with links from keys to ``page``."""

    def to_page(found: re.Match[str]) -> str:
        return KEY.sub(lambda key: f'<a href="{page}#{anchor(key[0])}">{key[0]}</a>', found[0])

    # Odd parts are what the outer group matched, and the name of its element follows.
    parts = LEFT_ALONE.split(html)
    return "".join(
        part if place % 3 == 1 else BRACKETS.sub(to_page, part) for place, part in enumerate(parts) if place % 3 != 2
    )


def on_page_content(html: str, *, page: Any, files: Any, **_: Any) -> str:
    """Called by MkDocs for each page."""
    references = files.get_file_from_path(TARGET)
    return html if page.file == references else linked(html, references.url_relative_to(page.file))
