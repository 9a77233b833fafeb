"""The block of the tables that is about a recording."""

import math
from pathlib import Path
from typing import Any

from fleet_bus.messages import VehicleProfile
from fleet_lab.paper import cells, cuts, models
from fleet_lab.paper.cells import KINDS, Block, Cell
from fleet_lab.paper.drives import Data
from fleet_lab.paper.formulas import FORMULAS
from fleet_lab.paper.recording import Laid, Recorded, even_steps, history_tracks, lay_all, serve, split
from fleet_lab.paper.study import OURS, PUBLISHED, Tell, drive_of, none_of
from vehicle_agent.recording import load_recording

_SYMBOLS = {formula.key: formula.symbol for formula in FORMULAS}


class RecordedStudy:
    """The scenarios over a recording. Raises ``RecordingError`` at once for one that cannot be read or does not fit."""

    def __init__(self, path: Path, profile: VehicleProfile) -> None:
        self.recorded: Recorded = split(load_recording(path), profile)
        self.laid: list[Laid] = []

    def block(self, tell: Tell) -> Block:
        """The sets of the tables and those of the reach server; positions are measured, and so is what is checked."""
        self.laid = lay_all(self.recorded)
        found: list[Cell] = []
        placed: list[dict[str, Any]] = []
        served: list[dict[str, Any]] = []
        for number, laid in enumerate(self.laid):
            symbol = _SYMBOLS[laid.key]
            if laid.formula is None or laid.placement is None:
                placed.append({"formula": laid.key, "left_out": laid.missing})
                continue
            where = {"formula": laid.key, "size": laid.placement.size, "stretch": laid.placement.stretch}
            turn = laid.formula.motion.turn if laid.formula.motion is not None else None
            placed.append(where if turn is None else where | {"turn": math.degrees(turn)})
            drives = [self.drive(laid)]
            if laid.formula.motion is None:
                found.append(cells.uncut_cell(drives, none_of(laid.formula), None))
            for way, ways, beside in (("published code", PUBLISHED, None), ("ours", OURS, cuts.published_zonotopes)):
                found += [
                    cells.cut_cell(drives, laid.formula, kind, ways[kind], beside, note=f"{way}, {symbol}")
                    for kind in KINDS
                ]
            for row in serve(self.recorded, laid, lambda part, n=number: tell((n + part) / len(self.laid))):  # type: ignore[misc]
                served.append({"formula": laid.key, **row.as_json()})
        extra: dict[str, Any] = {
            "recording": self.recorded.recording.name,
            "profile": self.recorded.profile.vehicle_class,
            "placed": placed,
            "served": served,
        }
        note = (
            "The regions are moved, turned and enlarged as little as it takes for the recorded drive to satisfy them, "
            "and the windows shortened where it has to be. The input of the tables' sets is the velocity over the last "
            "interval, since recorded commands do not carry the displacement. T(x) has its corner anywhere in the "
            "profile's measurement noise."
        )
        return Block("recording", f"Over a recording: {self.recorded.recording.name}", note, tuple(found), extra=extra)

    def drive(self, laid: Laid) -> cells.Drive:
        """The steps of the tested drive that a formula speaks about, as the published code computes their sets."""
        assert laid.placement is not None
        data = Data.of(history_tracks(self.recorded, laid.placement))
        track = laid.placement.track(self.recorded.track)
        drive = drive_of(track, data, models.as_published_code, self.recorded.noise)
        return drive.take(even_steps(track))
