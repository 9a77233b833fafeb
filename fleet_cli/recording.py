"""What the commands about recordings do, from what their command lines say."""

import threading
from collections.abc import Sequence
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any, Final

from fleet_bus.errors import UsageError
from fleet_bus.sessions import Role
from fleet_bus.zenoh_bus import open_bus
from fleet_cli import logs
from fleet_recorder.files import Folder
from fleet_recorder.layout import SceneMessage
from fleet_recorder.parts import Rules, Scene
from fleet_recorder.player import Player, Report
from fleet_recorder.reader import Reading
from fleet_recorder.recorder import Recorder, Summary

#: Summaries of the recorder, one a second, of which one is told.
_TOLD: Final = 5


def record(
    folder: Path,
    rules: Rules,
    limit: int | None,
    instance: str,
    routers: Sequence[str],
    stop: threading.Event,
    duration: float | None,
    *,
    scene: bool,
) -> dict[str, Any]:
    """Record the bus until ``stop``, or for ``duration`` seconds; what was done, as ``--json`` has it."""
    if limit is not None and limit < 2 * rules.part_bytes:
        raise UsageError(
            f"--limit-gb {limit / 1e9:g} is too little: at least two files of --rotate-mb {rules.part_bytes / 1e6:g} "
            "have to find room"
        )
    timer = None if duration is None else threading.Timer(duration, stop.set)
    with Folder(folder, limit) as opened:
        connect = partial(open_bus, Role.SERVICE, routers, stop)
        drawn = _scene if scene else None
        with Recorder(opened, rules, connect, instance=instance, scene=drawn) as recorder:
            logs.say(f"recorder {instance} writes to {folder}")
            if timer is not None:
                timer.daemon = True
                timer.start()
            recorder.run(stop, _Progress(recorder))
        summary = recorder.summary()
    if timer is not None:
        timer.cancel()
    return {
        **summary._asdict(),
        "files": [str(path) for path in recorder.parts.files],
        "folder": str(folder),
        "refused": recorder.rejections.snapshot(),
        "problem": recorder.parts.trouble,
    }


def _scene() -> Scene:
    """What turns messages of the bus into those that Foxglove draws."""
    from fleet_foxglove.messages import Scene as FoxgloveScene

    draw_regions = None
    # Regions of scenarios need the extras of server and pictures.
    with suppress(ModuleNotFoundError):
        from fleet_cli.scenario_outlines import outlines

        draw_regions = outlines
    made = FoxgloveScene(draw_regions)
    return lambda received: [SceneMessage(*message) for message in made.scene_messages(received)]


class _Progress:
    """Says every few seconds how far the recorder is."""

    def __init__(self, recorder: Recorder) -> None:
        self._recorder = recorder
        self._count = 0

    def __call__(self, summary: Summary) -> None:
        self._count += 1
        if self._count % _TOLD:
            return
        trouble = self._recorder.parts.trouble
        files = self._recorder.parts.files
        logs.tell(
            f"{summary.recorded} messages, {summary.bytes / 1e6:.1f} MB, {summary.waiting} waiting, {summary.lost} lost"
            + (f", {files[-1].name}" if files else "")
            + (f"; nothing can be recorded now: {trouble}" if trouble else "")
        )


def play(
    paths: Sequence[Path],
    routers: Sequence[str],
    stop: threading.Event,
    *,
    speed: float,
    everything: bool,
    shift: bool,
    linger: float,
) -> tuple[Report, Reading]:
    """Publish recordings again; what was published, and what was read."""
    reading = Reading(paths, warn=logs.warn)
    with (
        open_bus(Role.SERVICE, routers, stop) as bus,
        Player(bus, speed=speed, everything=everything, shift=shift) as p,
    ):
        logs.say(f"playing {', '.join(map(str, paths))}")
        report = p.play(reading, stop)
        stop.wait(linger)
    return report, reading
