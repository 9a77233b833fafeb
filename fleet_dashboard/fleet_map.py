"""The map as an element of the page."""

from pathlib import Path

import nicegui
from nicegui import ui

from fleet_dashboard.picture import LABELS, Mark
from fleet_dashboard.theme import PALETTE
from fleet_dashboard.view import View

# NiceGUI ships three.js with its scene; the second folder holds the modules of this map.
_SCENE = Path(nicegui.__file__).parent / "elements" / "scene" / "dist"
_MODULES = Path(__file__).parent / "map"


class FleetMap(ui.element, component="fleet_map.js", esm={"nicegui-scene": str(_SCENE), "fleet-map": str(_MODULES)}):
    """Draws what a view sees. Emits ``pick`` with the id of the vehicle that was clicked, or none."""

    def __init__(self, view: View, *, follow: str | None = None) -> None:
        super().__init__()
        self.props["view"] = view.key
        self.props["palette"] = PALETTE
        self.props["labels"] = list(LABELS)
        self.props["marks"] = {str(int(mark)): mark.words for mark in Mark}
        self.props["info"] = True
        self.props["names"] = True
        self.props["target"] = follow or ""

    def show(self, name: str, value: bool) -> None:
        """Turn ``info`` (regions and what they cut away) or ``names`` on or off."""
        self.props[name] = value
        self.update()

    def follow(self, vehicle: str | None) -> None:
        """Keep a vehicle in the middle, or none."""
        self.run_method("follow", vehicle)

    def fit(self) -> None:
        """See everything."""
        self.run_method("fit")

    def zoom(self, factor: float) -> None:
        """See more or less."""
        self.run_method("zoom", factor)
