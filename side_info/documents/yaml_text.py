"""YAML read strictly, with the place of everything in it.

A strict subset: one document, no tags, anchors, aliases or repeated keys, and plain scalars are ``true``,
``false``, ``null``, decimal numbers or text (YAML 1.1 would read ``1:30`` as ninety and ``no`` as false).
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import yaml

from fleet_bus.errors import ScenarioError
from side_info.documents.source_location import Excerpt, error_at

#: Bytes of UTF-8; what a scenario may have on the bus.
MAX_BYTES: Final = 200_000

Path = tuple[str | int, ...]

_INTEGER: Final = re.compile(r"[+-]?\d{1,18}", re.ASCII)
_NUMBER: Final = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII)
_WORDS: Final = {"true": True, "false": False, "null": None, "": None}


@dataclass(frozen=True, slots=True)
class YamlText:
    """A YAML document: ``fields`` as plain data, and where each of its values and keys stands."""

    text: str
    source: str
    fields: Any
    values: dict[Path, yaml.Node]
    keys: dict[Path, yaml.Node]

    def error(self, path: Path, problem: str, *, key: bool = False) -> ScenarioError:
        """Error at the value (or ``key``) of ``path``, or at the nearest part of the document around it."""
        places = self.keys if key else self.values
        while path and path not in places:
            path = path[:-1]
        node = places.get(path)
        return error_at(self.source, self.text, node.start_mark.index if node is not None else 0, problem)

    def excerpt(self, path: Path) -> Excerpt:
        """The text at ``path``, which is a scalar, with the place of each of its characters."""
        node = self.values[path]
        assert isinstance(node, yaml.ScalarNode)
        return Excerpt(node.value, self.source, self.text, _offsets(node, self.text))


def read_yaml(text: str, source: str) -> YamlText:
    """Read a document; raise ``ScenarioError`` with line, column and caret if it is not of the subset."""
    size = len(text.encode("utf-8", "replace"))
    if size > MAX_BYTES:
        raise error_at(source, text, 0, f"the document has {size} bytes: expected at most {MAX_BYTES}")
    try:
        root = yaml.compose(text, _Loader)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        problem = ", ".join(part for part in (error.context, error.problem) if part)
        if "mapping values" in problem:
            problem += ": put a formula that has ': ' in quotes"
        raise error_at(source, text, mark.index if mark else 0, f"not YAML: {problem}") from None
    except yaml.reader.ReaderError as error:
        raise error_at(source, text, error.position, f"not YAML: character {chr(error.character)!r}") from None
    except RecursionError:
        raise error_at(source, text, 0, "not YAML of a scenario: nested too deeply") from None
    if root is None:
        raise error_at(source, text, 0, "the document is empty: expected a map that begins with scenario:")
    read = YamlText(text, source, None, {}, {})
    return YamlText(text, source, _value(root, (), read), read.values, read.keys)


class _Loader(yaml.BaseLoader):
    """Composes nodes; aliases could make a document of exponential size."""

    def compose_node(self, parent: yaml.Node | None, index: int) -> yaml.Node | None:
        node = super().compose_node(parent, index)
        for anchored in self.anchors.values():
            raise yaml.composer.ComposerError(None, None, "anchors and aliases are not allowed", anchored.start_mark)
        return node


def _value(node: yaml.Node, path: Path, read: YamlText) -> Any:
    read.values[path] = node
    _refuse_tag(node, read)
    if isinstance(node, yaml.SequenceNode):
        return [_value(item, (*path, index), read) for index, item in enumerate(node.value)]
    if isinstance(node, yaml.MappingNode):
        fields: dict[str, Any] = {}
        for key, item in node.value:
            place = (*path, str(key.value)) if isinstance(key, yaml.ScalarNode) else (*path, "?")
            repeated = place in read.keys
            read.keys[place] = key
            if not isinstance(key, yaml.ScalarNode):
                raise read.error(place, "a key must be plain text", key=True)
            _refuse_tag(key, read)
            if repeated:
                raise read.error(place, f"the key {key.value[:40]!r} is repeated", key=True)
            fields[key.value] = _value(item, place, read)
        return fields
    assert isinstance(node, yaml.ScalarNode)
    return _scalar(node)


def _refuse_tag(node: yaml.Node, read: YamlText) -> None:
    start = node.start_mark.index
    if read.text[start : start + 1] == "!":
        raise error_at(read.source, read.text, start, "tags are not allowed")


def _scalar(node: yaml.ScalarNode) -> str | int | float | bool | None:
    text: str = node.value
    if node.style is not None:
        return text
    if text in _WORDS:
        return _WORDS[text]
    if _INTEGER.fullmatch(text):
        return int(text)
    return float(text) if _NUMBER.fullmatch(text) else text


def _offsets(node: yaml.ScalarNode, document: str) -> Sequence[int]:
    """Place in the document of each character of a scalar's value, and of its end.

    However a scalar is quoted, indented or folded, its characters that are no blanks come in the same order;
    where that fails (escapes) all that is known is where the scalar begins.
    """
    value: str = node.value
    start, end = node.start_mark.index, node.end_mark.index
    if node.style in ("|", ">"):
        start = document.find("\n", start, end)
    elif node.style is not None:
        start, end = start + 1, end - 1
    places = [place for place in range(start, end) if not document[place].isspace()]
    if [document[place] for place in places] != [character for character in value if not character.isspace()]:
        return [node.start_mark.index] * (len(value) + 1)
    after = places[-1] + 1 if places else start
    offsets, seen = [], 0
    for character in value:
        offsets.append(places[seen] if seen < len(places) else after)
        seen += not character.isspace()
    return [*offsets, after]
