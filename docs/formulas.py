"""A hook of MkDocs: formulas in fenced blocks named ``math`` become MathML while the site is built.

So browsers set them themselves, without a script, a font or a connection. In the text around them formulas are plain
characters; of these only what stands behind ``_`` or ``^`` is lowered or raised.
"""

import re
from typing import Any

from latex2mathml.converter import convert

#: Pages whose running text has indices, such as ``r_ji``.
INDICES_ON = ("mathematics.md",)
TAG = re.compile(r"\\tag\{(\d+)\}")
INDEX = re.compile(r"(?<=[^\s_])([_^])(?:\{([^{}<>]*)\}|([^\W_]+|∞))")
ELEMENTS = {"_": "sub", "^": "sup"}
#: What is left as it is: code, formulas, and where a link leads.
LEFT_ALONE = re.compile(r"(<(pre|code|math)\b.*?</\2>|<[^>]*>)", re.S)
#: What latex2mathml leaves as it is where it does not know a command or an environment.
UNKNOWN = re.compile(r"\\\w+|<m[io]>&</m[io]>")
#: Names of functions; browsers would set them as if they were signs between two numbers. A bracket follows closely.
NAME = re.compile(r"<m[io](?: movablelimits=\"true\")?>([a-z]{2,})</m[io]>(?=(<mo stretchy=\"false\">&#x00028;)?)")
#: A minus behind what opens or parts is a sign.
SIGN = re.compile(r"(?<=>(?:&#x00028;|&#x0005B;|&#x0002C;)</mo>)<mo(?=>&#x02212;<)")
#: Letters of other styles are characters of their own; browsers ignore this attribute, all but one value of it.
STYLED = re.compile(r'mathvariant="(?!normal")')


def mathml(source: str) -> tuple[str, str]:
    """A displayed formula as MathML, and its number, empty if it has none.

    Raises:
        ValueError: It has something that would not be seen as it is meant.
    """
    numbers = TAG.findall(source)
    if len(numbers) > 1:
        raise ValueError(f"one block, one number: {source!r}")
    # A line break in the source is a space; two of them in a row would end the formula elsewhere.
    code = convert(" ".join(TAG.sub("", source).split()), display="block")
    for pattern in (UNKNOWN, STYLED):
        if found := pattern.search(code):
            raise ValueError(f"cannot be set: {found[0]} in {source!r}")

    def spaced(found: re.Match[str]) -> str:
        return f'<mo lspace="0" rspace="{"0" if found[2] else "0.17em"}">{found[1]}</mo>'

    return SIGN.sub('<mo form="prefix"', NAME.sub(spaced, code)), "".join(numbers)


def fence(source: str, language: str, css_class: str, options: Any, md: Any, **_: Any) -> str:
    """Called by the Markdown extension for each block."""
    code, number = mathml(source)
    shown = f'<span class="number">({number})</span>' if number else ""
    name = f' id="formula-{number}"' if number else ""
    return f'<div class="{css_class}"{name}>{code}{shown}</div>'


def with_indices(html: str) -> str:
    """``html`` in which what stands behind ``_`` is lowered, and behind ``^`` raised, but in code."""

    def moved(found: re.Match[str]) -> str:
        element = ELEMENTS[found[1]]
        return f"<{element}>{found[2] or found[3]}</{element}>"

    # Every third part is the name of an element that was left alone, every part before it that element.
    parts = LEFT_ALONE.split(html)
    return "".join(
        part if place % 3 == 1 else INDEX.sub(moved, part) for place, part in enumerate(parts) if place % 3 != 2
    )


def on_config(config: Any) -> Any:
    """Called by MkDocs once: the fence is added to those of the Markdown extension."""
    fences = config.mdx_configs.setdefault("pymdownx.superfences", {}).setdefault("custom_fences", [])
    fences.append({"name": "math", "class": "formula", "format": fence})
    return config


def on_page_content(html: str, *, page: Any, **_: Any) -> str:
    """Called by MkDocs for each page."""
    return with_indices(html) if page.file.src_uri in INDICES_ON else html
