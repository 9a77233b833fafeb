"""Regions of scenarios as lines on the map.

What a formula means is not this package's business, which knows the bus alone: whoever starts the page hands in a
function from a document's text to ``Regions``. Without one, a document is named and nothing of it is drawn.
"""

from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from threading import Lock
from typing import Final

import numpy as np
import structlog

from fleet_bus.messages import ScenarioDocument
from fleet_dashboard.picture import Floats

_log = structlog.get_logger(__name__)

#: Scenarios whose regions are kept.
MOST_SCENARIOS: Final = 64


@dataclass(frozen=True, slots=True, eq=False)
class Regions:
    """Borders of the regions of one scenario: segments (S, 2, 2) in the plane by name, with a point (2,) for the name,
    what predicates each is made of, and why others are not drawn."""

    borders: Mapping[str, Floats]
    anchors: Mapping[str, tuple[float, float]]
    predicates: Mapping[str, frozenset[str]] = field(default_factory=dict)
    left_out: Mapping[str, str] = field(default_factory=dict)


def border(x: Floats, y: Floats, margin: Floats) -> Floats:
    """Segments (S, 2, 2) between where ``margin`` (len(y), len(x)) on a raster is below 0 and where it is not.

    Marching squares: in each cell the crossings of its edges are joined, of four the first with the second.
    """
    holds = margin >= 0
    with np.errstate(invalid="ignore", divide="ignore"):
        across = np.clip(margin[:, :-1] / (margin[:, :-1] - margin[:, 1:]), 0, 1)
        along = np.clip(margin[:-1] / (margin[:-1] - margin[1:]), 0, 1)
    gx, gy = np.meshgrid(x, y)
    # Crossings on edges along x (rows) and along y (columns), NaN where there is none.
    flat = np.stack([gx[:, :-1] + across * np.diff(x), gy[:, :-1]], axis=-1)
    flat[holds[:, :-1] == holds[:, 1:]] = np.nan
    steep = np.stack([gx[:-1], gy[:-1] + along * np.diff(y)[:, None]], axis=-1)
    steep[holds[:-1] == holds[1:]] = np.nan
    edges = np.stack([flat[:-1], steep[:, 1:], flat[1:], steep[:, :-1]], axis=2)
    crossed = np.isfinite(edges[..., 0])
    cells = crossed.sum(axis=2) >= 2
    points, found = edges[cells], crossed[cells]
    order = np.argsort(~found, axis=1, kind="stable")
    points = np.take_along_axis(points, order[..., None], axis=1)
    four = found.sum(axis=1) == 4
    return np.concatenate([points[:, :2], points[four, 2:]])


class RegionStore:
    """Regions of the newest document of each scenario. They are worked out on a thread of their own."""

    def __init__(self, draw: Callable[[str], Regions] | None) -> None:
        self._draw = draw
        self._lock = Lock()
        self._worker = ThreadPoolExecutor(1, thread_name_prefix="regions")
        self._versions: dict[str, int] = {}
        self._regions: dict[str, Regions] = {}
        self._problems: dict[str, str] = {}
        #: Grows with each change of the regions.
        self.number = 0

    def document(self, document: ScenarioDocument) -> None:
        """A document is in force, unless it is not newer than the one that was."""
        name = document.scenario
        if self._versions.get(name, 0) >= document.version:
            return
        if name not in self._versions and len(self._versions) >= MOST_SCENARIOS:
            return
        self._versions[name] = document.version
        if self._draw is None:
            self._keep(name, None, "regions are not drawn: the server's packages are not installed")
        else:
            self._worker.submit(self._work, name, document.text)

    def _work(self, name: str, text: str) -> None:
        assert self._draw is not None
        try:
            self._keep(name, self._draw(text), "")
        except Exception as error:
            _log.warning("regions cannot be drawn", scenario=name, error=str(error)[:300])
            self._keep(name, None, f"its regions cannot be drawn: {error!s:.200}")

    def _keep(self, name: str, regions: Regions | None, problem: str) -> None:
        with self._lock:
            self._regions.pop(name, None)
            self._problems.pop(name, None)
            if regions is not None:
                self._regions[name] = regions
            if problem:
                self._problems[name] = problem
            self.number += 1

    def all(self) -> dict[str, Regions]:
        """Regions by scenario."""
        with self._lock:
            return dict(self._regions)

    def problems(self) -> dict[str, str]:
        """By scenario, why nothing of it is drawn."""
        with self._lock:
            return dict(self._problems)
