"""Regions of scenarios for the page, which itself does not know what a formula means."""

import numpy as np

from fleet_cli.scenario_plane import lay_out
from fleet_dashboard.regions import Regions, border
from side_info.documents.scenario import Scenario
from side_info.stl.normal_form import literals_in


def draw_regions(text: str) -> Regions:
    """Borders of the regions of a scenario document; raise ``ScenarioError`` if it is none."""
    scenario = Scenario.parse(text)
    plane, drawn, left_out = lay_out(scenario)
    borders, anchors = {}, {}
    for region in drawn:
        assert plane is not None
        borders[region.name] = border(plane.x, plane.y, region.margin)
        rows, columns = np.nonzero(region.margin >= 0)
        if len(rows):
            # The name stands in the upper left corner of what holds.
            row = rows.max()
            anchors[region.name] = float(plane.x[columns[rows == row].min()]), float(plane.y[row])
    names = [predicate.name for predicate in scenario.predicates]
    predicates = {
        name: frozenset(names[index] for index in literals_in(region)) for name, region in scenario.regions.items()
    }
    empty = {name: "it holds nowhere" for name in borders if name not in anchors}
    borders = {name: lines for name, lines in borders.items() if name in anchors}
    return Regions(borders, anchors, predicates, {**left_out, **empty})
