"""Watching the files of scenarios: which change of a file becomes a new version, and why another does not.

``take_in`` decides, from what was seen before and what is seen now; ``look`` sees. Neither knows a clock: how often to
look is up to the caller.
"""

import stat
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final, Self

from fleet_bus.errors import ScenarioError
from side_info.documents.scenario import Scenario, shipped
from side_info.documents.yaml_text import MAX_BYTES

INVALID: Final = "document_invalid"
NOT_RAISED: Final = "document_version"
RENAMED: Final = "document_renamed"
UNREADABLE: Final = "document_unreadable"
#: Why a change of a file is refused, as it is counted.
REASONS: Final = (INVALID, NOT_RAISED, RENAMED, UNREADABLE)


@dataclass(frozen=True, slots=True)
class Stamp:
    """What of a file changes with its content: times in ns since the Unix epoch, bytes, and which file it is."""

    modified_ns: int
    changed_ns: int
    size: int
    inode: int


@dataclass(frozen=True, slots=True)
class Look:
    """A file as it is at one moment; ``text`` is None where there is none to read, and ``problem`` says why."""

    stamp: Stamp | None
    text: str | None
    problem: str = ""

    def shows(self, other: "Look") -> bool:
        """Whether both have the same content."""
        return (self.text, self.problem) == (other.text, other.problem)


@dataclass(frozen=True, slots=True)
class Watched:
    """A file and the scenario that is published of it.

    ``seen`` is the last look, ``judged`` the last one that was decided about, ``settled`` whether the last two looks
    were equal in content and stamp.
    """

    path: Path
    scenario: Scenario
    seen: Look
    judged: Look
    settled: bool = False

    @classmethod
    def begin(cls, path: Path, scenario: Scenario) -> Self:
        """Watch ``path``, of which ``scenario`` has been read."""
        read = Look(None, scenario.text)
        return cls(path, scenario, read, read)

    @property
    def behind(self) -> bool:
        """Whether what is published is not what the file says."""
        return self.judged.text != self.scenario.text


@dataclass(frozen=True, slots=True)
class Refusal:
    """Why what a file says now is not published; ``reason`` is the name under which it is counted."""

    reason: str
    detail: str


def files(names: Sequence[str], scenarios: Sequence[Scenario]) -> dict[str, Path]:
    """Which of ``scenarios``, loaded from ``names``, can be watched, by name: those of files, not the shipped ones."""
    return {
        scenario.name: Path(name)
        for name, scenario in zip(names, scenarios, strict=True)
        if name not in shipped() and Path(name).is_file()
    }


def take_in(watched: Watched, look: Look) -> tuple[Watched, Scenario | Refusal | None]:
    """What follows from a look: a scenario to publish, a refusal to tell of once, or nothing.

    A content is decided about when two looks in a row show it, so that a file that is being written, or is away for
    the moment in which an editor puts another in its place, is neither refused nor published.
    """
    again = look.shows(watched.seen)
    after = replace(watched, seen=look, settled=look == watched.seen)
    if not again or look.shows(watched.judged):
        return after, None
    after = replace(after, judged=look)
    if look.text == watched.scenario.text:
        return after, None
    decision = _judge(watched, look)
    if isinstance(decision, Scenario):
        after = replace(after, scenario=decision)
    return after, decision


def _judge(watched: Watched, look: Look) -> Scenario | Refusal:
    path, published = watched.path, watched.scenario
    stays = f"version {published.version} stays published"
    if look.text is None:
        return Refusal(UNREADABLE, f"{path}: {look.problem}; {stays}")
    try:
        scenario = Scenario.parse(look.text, str(path))
    except ScenarioError as error:
        return Refusal(INVALID, f"{error}\n{stays}")
    if scenario.name != published.name:
        return Refusal(
            RENAMED,
            f"{path}: it now names scenario {scenario.name!r}, {published.name!r} is published of it: name it back, "
            f"or serve the new scenario from a file of its own; {stays}",
        )
    if scenario.version <= published.version:
        return Refusal(
            NOT_RAISED,
            f"{path}: its text changed, its version {scenario.version} did not rise above {published.version}: "
            f"raise version to {published.version + 1} to publish it; {stays}",
        )
    return scenario


def look(watched: Watched) -> Look:
    """Look at the file; it is read only if it changed, or was last read when it had just changed.

    A file that changes twice between two ticks of its file system's clock has one stamp for both contents. So one that
    changed is read until two looks in a row found the same.
    """
    stamp, problem = _stamp(watched.path)
    if stamp is None:
        return Look(None, None, problem)
    if watched.settled and stamp == watched.seen.stamp:
        return watched.seen
    try:
        with watched.path.open(encoding="utf-8") as file:
            return Look(stamp, file.read(MAX_BYTES + 1))
    except OSError as error:
        return Look(stamp, None, f"cannot be read: {error.strerror}")
    except ValueError:
        return Look(stamp, None, "is not UTF-8 text")


def _stamp(path: Path) -> tuple[Stamp | None, str]:
    try:
        status = path.stat()
    except OSError as error:
        return None, f"cannot be read: {error.strerror}"
    # Opening a pipe could wait for ever.
    if not stat.S_ISREG(status.st_mode):
        return None, "is no file any more"
    return Stamp(status.st_mtime_ns, status.st_ctime_ns, status.st_size, status.st_ino), ""
