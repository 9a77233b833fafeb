"""Text of a formula to its syntax tree (grammar.lark), with errors a person can act on."""

from functools import cache
from importlib import resources
from typing import Any, Final

from lark import Lark, Token, Tree
from lark.exceptions import UnexpectedCharacters, UnexpectedInput, UnexpectedToken

from fleet_bus.errors import ScenarioError
from side_info.documents.hints import sign_or_word
from side_info.documents.source_location import Excerpt

Branch = Tree[Token] | Token

MAX_LENGTH: Final = 20_000
MAX_DEPTH: Final = 64

_READABLE: Final = {
    "NUMBER": "a number",
    "NAME": "a name",
    "LSQB": "a window '[a:b]'",
    "RSQB": "']'",
    "LPAR": "'('",
    "RPAR": "')'",
    "COLON": "':'",
    "COMMA": "','",
    "UNIT": "a unit (ms, s, min)",
    "COMPARE": "a comparison",
    "_AND": "'and'",
    "OR": "'or'",
    "NOT": "'not'",
    "IMPLIES": "'->'",
    "ALWAYS": "'always'",
    "EVENTUALLY": "'eventually'",
    "UNTIL": "'until'",
    "MINUS": "'-'",
    "PLUS": "'+'",
    "STAR": "'*'",
    "SLASH": "'/'",
    "_POWER": "'^'",
    "$END": "the end",
}


def syntax_tree(excerpt: Excerpt) -> Branch:
    """Syntax tree of a formula; raise ``ScenarioError`` at the first character that does not fit the grammar.

    Also refused: text of more than ``MAX_LENGTH`` characters and trees of more than ``MAX_DEPTH`` levels, so
    that whatever walks a formula afterwards may recurse.
    """
    if len(excerpt.text) > MAX_LENGTH:
        raise excerpt.error(0, f"a formula has at most {MAX_LENGTH} characters, this one {len(excerpt.text)}")
    if not excerpt.text.strip():
        raise excerpt.error(0, "the formula is empty: expected something like always[0:5 s](x >= 0)")
    try:
        tree = _parser().parse(excerpt.text)
    except UnexpectedInput as error:
        raise _refusal(excerpt, error) from None
    _check_depth(excerpt, tree)
    return tree


def start_of(branch: Branch) -> int:
    """Place of the first character of a branch."""
    start = branch.start_pos if isinstance(branch, Token) else branch.meta.start_pos
    assert start is not None
    return start


@cache
def _parser() -> Lark:
    grammar = resources.files("side_info").joinpath("grammar.lark").read_text(encoding="utf-8")
    return Lark(grammar, parser="lalr", propagate_positions=True, maybe_placeholders=False)


def _refusal(excerpt: Excerpt, error: UnexpectedInput) -> ScenarioError:
    found: Any = error.pos_in_stream
    place = int(found)
    fitting: set[str] = set()
    came = "text"
    if isinstance(error, UnexpectedCharacters):
        came, fitting = f"character {error.char!r}", error.allowed
    elif isinstance(error, UnexpectedToken):
        came, fitting = repr(str(error.token)), error.accepts or error.expected
        if error.token.type == "$END":
            came, place = "end", len(excerpt.text.rstrip())
    expected = ", ".join(sorted(_READABLE[name] for name in fitting if name in _READABLE))
    return excerpt.error(place, f"unexpected {came:.40}: expected {expected}{sign_or_word(excerpt.text, place)}")


def _check_depth(excerpt: Excerpt, tree: Branch) -> None:
    level: list[Branch] = [tree]
    for _ in range(MAX_DEPTH):
        level = [child for node in level if isinstance(node, Tree) for child in node.children]
        if not level:
            return
    raise excerpt.error(start_of(level[0]), f"nested more than {MAX_DEPTH} levels deep")
