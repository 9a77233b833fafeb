"""What somebody probably meant who wrote something else."""

import re
from collections.abc import Iterable
from difflib import get_close_matches
from typing import Final

#: Words of the logic that a place may ask for.
_LOGIC: Final = ("always", "globally", "eventually", "finally", "until", "and", "or", "not", "implies")

_SIGNS: Final = {
    "≤": "<=", "≥": ">=", "→": "->", "⇒": "->", "∧": "and", "\N{LOGICAL OR}": "or", "¬": "not",
    "−": "-", "·": "*", "×": "*",
}  # fmt: skip
_UNEQUAL: Final = "there is no sign for unequal: write not (a == b)"


def close(word: str, names: Iterable[str]) -> str:
    """``; did you mean 'lane'?`` if one of ``names`` is close to ``word``, else nothing."""
    by_case = {name.lower(): name for name in names}
    found = get_close_matches(word[:40].lower(), by_case, 1, 0.7)
    return f"; did you mean {by_case[found[0]]!r}?" if found else ""


def word_or_function(word: str, functions: Iterable[str]) -> str:
    """As ``close``, of the functions and the words of the logic."""
    return close(word, (*functions, *_LOGIC))


def sign_or_word(text: str, at: int) -> str:
    """What to write in place of what does not fit at the character ``at`` of a formula; nothing if unknown."""
    # So that no long text is searched again and again.
    past = text[max(at - 40, 0) : at]
    if text.startswith("≠", at) or re.match(r"!\s*=", text[at:]) or re.search(r"!\s*$", past):
        return f"; {_UNEQUAL}" if "=" in text[max(at - 2, 0) : at + 3] or "≠" in text[at : at + 1] else ""
    if text[at : at + 1] in _SIGNS:
        return f"; write {_SIGNS[text[at]]}"
    if text[at : at + 1] == "=":
        return "; for a comparison write =="
    here, before = re.match(r"\w+", text[at:]), re.search(r"(\w+)\s*$", past)
    for word in (here and here[0], before and before[1]):
        if word and word not in _LOGIC and word.lower() in _LOGIC:
            return f"; did you mean {word.lower()!r}?"
    return ""
