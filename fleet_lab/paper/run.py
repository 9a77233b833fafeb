"""Works through the parts of the study; what is finished is on disk before the next part begins."""

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from fleet_lab.files import write_json, write_text
from fleet_lab.interruption import Interruption
from fleet_lab.paper import figures, report
from fleet_lab.paper.cells import Block
from fleet_lab.paper.recorded_block import RecordedStudy
from fleet_lab.paper.study import Study, Tell, parts


@dataclass(frozen=True, slots=True)
class Outcome:
    """The JSON ``document``, why the run counts as failed, and whether it was interrupted."""

    document: dict[str, Any]
    failures: list[str]
    interrupted: bool

    def print(self) -> None:
        """The summary, on the terminal."""
        report.print_summary(Console(), self.document)


def run(folder: Path, seed: int, recorded: RecordedStudy | None, missing: str, *, quiet: bool = False) -> Outcome:
    """Compute every part and write ``report.md``, ``report.json`` and the figures into ``folder``.

    ``missing`` says why there is no recording where ``recorded`` is None. Raises ``UsageError`` where a file cannot be
    written.
    """
    study = Study(seed)
    work: list[tuple[str, Callable[[Tell], Block | None]]] = list(parts(study))
    if recorded is not None:
        work.append(("over the recording", recorded.block))
    drawn: list[str] = []
    drawings: list[tuple[str, Callable[[], list[Path]]]] = [
        ("figures of the lot", lambda: figures.draw_lot(study, folder)),
        ("figures of the roundabout", lambda: figures.draw_ring(study, folder)),
        ("figure of the demonstrations", lambda: figures.draw_demonstrations(study, folder)),
    ]
    if recorded is not None:
        drawings.append(("figures over the recording", lambda: figures.draw_recorded(recorded, folder)))
    for title, draw in drawings:
        work.append((title, lambda tell, draw=draw: drawn.extend(path.name for path in draw())))  # type: ignore[misc]
    blocks: list[Block] = []
    pending = [title for title, _ in work]
    interrupted = False

    def write() -> dict[str, Any]:
        document = report.as_document(seed, blocks, drawn, pending, None if recorded is not None else missing)
        write_json(document, folder / "report.json", "-o")
        write_text("-o", folder / "report.md", report.as_markdown(document))
        return document

    with Interruption() as interruption, _progress(quiet) as progress:
        try:
            with interruption.held():
                document = write()
            for number, (title, compute) in enumerate(work, start=1):
                task = progress.add_task(f"{number}/{len(work)} {title}", total=1.0)
                began = time.perf_counter()
                block = compute(lambda part, task=task: progress.update(task, completed=part))  # type: ignore[misc]
                if interruption.asked:
                    raise KeyboardInterrupt
                with interruption.held():
                    if block is not None:
                        blocks.append(block)
                    pending.remove(title)
                    document = write()
                progress.remove_task(task)
                progress.console.print(f"{number}/{len(work)} {title}: {time.perf_counter() - began:.1f} s")
        except BaseException as error:
            # Compiled code makes another exception of the signal.
            if not interruption.is_cause_of(error):
                raise
            interrupted = True
    return Outcome(document, report.failures(document), interrupted)


def _progress(quiet: bool) -> Progress:
    columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn())
    return Progress(*columns, console=Console(stderr=True, quiet=quiet), transient=True)
