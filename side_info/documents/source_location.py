"""Where in a text something stands, and errors that show it."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, Self

from fleet_bus.errors import ScenarioError

_SHOWN: Final = 100


@dataclass(frozen=True, slots=True)
class Excerpt:
    """Text of a formula, and where each of its characters stands in the document it was taken from.

    ``offsets`` has one place more than ``text`` has characters: that of its end.
    """

    text: str
    source: str
    document: str
    offsets: Sequence[int]

    @classmethod
    def alone(cls, text: str, source: str) -> Self:
        """Text that is a document of its own."""
        return cls(text, source, text, range(len(text) + 1))

    def place(self, at: int) -> tuple[int, int]:
        """Line and column in the document, both from 1, of the character ``at`` of ``text``."""
        return line_and_column(self.document, self.offsets[min(at, len(self.text))])

    def error(self, at: int, problem: str) -> ScenarioError:
        """Error about the character ``at`` of ``text``, shown where it stands in the document."""
        return error_at(self.source, self.document, self.offsets[min(at, len(self.text))], problem)


def line_and_column(document: str, offset: int) -> tuple[int, int]:
    """Line and column, both from 1, of the character ``offset``."""
    return document.count("\n", 0, offset) + 1, offset - document.rfind("\n", 0, offset)


def error_at(source: str, document: str, offset: int, problem: str) -> ScenarioError:
    """Error ``source:line:column: problem``, then the line and a caret below the character ``offset``."""
    start = document.rfind("\n", 0, offset) + 1
    end = document.find("\n", offset)
    line = document[start : end if end >= 0 else len(document)].rstrip()
    column = offset - start
    first = max(0, column - _SHOWN // 2)
    # A document may hold anything, and the message goes to a terminal.
    shown = "".join(c if c.isprintable() else " " for c in line[first : first + _SHOWN])
    if first:
        shown = "…" + shown[1:]
    number, place = line_and_column(document, offset)
    return ScenarioError(f"{source}:{number}:{place}: {problem}\n  {shown}\n  {' ' * (column - first)}^")
