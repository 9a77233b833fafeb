"""Lines around the regions of a scenario document, for viewers that draw lines."""

from typing import Final

import numpy as np
from contourpy import LineType, contour_generator

from fleet_bus.errors import MessageError, ScenarioError
from fleet_bus.messages import ScenarioDocument
from fleet_cli.scenario_plane import Drawn, Plane, lay_out
from fleet_foxglove.scene import Region, Regions
from reach_server.numeric.types import FloatArray
from side_info.documents.scenario import Scenario

#: A vertex this close to the line between its neighbours, as a part of the plane's width, is left out.
_STRAIGHT: Final = 1e-7


def outlines(document: ScenarioDocument) -> Regions:
    """Regions of a published scenario by the lines where they begin, within the part of the plane that pictures show.

    Lines of curved regions are as exact as the raster is fine. Raises ``MessageError("malformed")`` for a text that is
    no scenario.
    """
    try:
        scenario = Scenario.parse(document.text, document.scenario)
    except ScenarioError as error:
        raise MessageError("malformed", str(error)) from None
    try:
        with np.errstate(all="ignore"):
            plane, drawn, left_out = lay_out(scenario)
            if plane is None:
                return Regions(document.scenario, ("", ""), [], left_out)
            regions = [Region(region.name, _lines(plane, region)) for region in drawn]
    # Numbers that make no picture: bounds whose difference is beyond all floats, for instance.
    except (ArithmeticError, ValueError, RecursionError) as error:
        raise MessageError("range", f"the regions of {document.scenario} cannot be drawn: {error}") from None
    return Regions(document.scenario, plane.names, regions, left_out)


def _lines(plane: Plane, region: Drawn) -> list[FloatArray]:
    contour = contour_generator(plane.x, plane.y, region.margin, line_type=LineType.Separate)
    lines = [np.asarray(line) for line in contour.lines(0.0)]
    return [_straightened(line, float(np.ptp(plane.x))) for line in lines if len(line) > 1 and np.isfinite(line).all()]


def _straightened(line: FloatArray, width: float) -> FloatArray:
    """A line (K, 2) without the vertices that lie between their neighbours."""
    before, after = line[1:-1] - line[:-2], line[2:] - line[:-2]
    length = np.hypot(*after.T)
    away = np.abs(before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0]) / np.where(length > 0, length, 1.0)
    kept = np.concatenate([[True], (away > _STRAIGHT * width) | (length == 0), [True]])
    return np.asarray(line[kept])
