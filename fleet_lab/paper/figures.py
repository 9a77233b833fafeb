"""The figures: sets along a drive over lot, roundabout and recording, and how the unsound forms lose the vehicle."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Rectangle

from fleet_bus.errors import UsageError
from fleet_lab.paper import cuts, models
from fleet_lab.paper.cells import Drive
from fleet_lab.paper.formulas import PHI_P, PHI_R, PHI_THETA, Disc, Formula, Strip
from fleet_lab.paper.recorded_block import RecordedStudy
from fleet_lab.paper.study import Study
from reach_server.numeric.types import FloatArray
from reach_server.sets import ConstrainedZonotope, Zonotope
from reach_server.sets.plotting import draw_sets

#: Sets shown along a drive.
_SHOWN: Final = 6
_FORMATS: Final = ("png", "pdf")
_UNCUT: Final[dict[str, Any]] = {"facecolor": "none", "edgecolor": "0.55", "linewidth": 0.8}
_PUBLISHED: Final[dict[str, Any]] = {"facecolor": "none", "edgecolor": "C1", "linewidth": 1.1, "linestyle": "--"}
_OURS: Final[dict[str, Any]] = {"facecolor": ("C0", 0.22), "edgecolor": "C0", "linewidth": 1.1}
_REGION: Final[dict[str, Any]] = {"facecolor": "0.95", "edgecolor": "0.8", "linewidth": 0.8, "zorder": 0}
#: m that regions without an end are drawn beyond the drive.
_BEYOND: Final = 2.5


def draw_lot(study: Study, folder: Path) -> list[Path]:
    """The paper's figure of the lot: sets without constraints, with φ_p and with φ_θ."""
    path = study.lot[0].position
    figure, axes = _figure(3, 4.7)
    for axis, formula, title in zip(axes, (None, PHI_P, PHI_THETA), ("none", "φ_p", "φ_θ"), strict=True):
        drive, truth = _shown(study.drives(PHI_P, models.as_published_code)[0])
        _draw_place(axis, PHI_P, path)
        _draw_cuts(axis, drive, formula)
        axis.plot(*truth.T, "k.", markersize=3, zorder=5, label="true next position")
        axis.set_title(f"constraints: {title}")
        if formula is PHI_THETA:
            _enlarge(axis, drive, formula, -1)
    return _save(figure, axes, "parking-lot", "Parking lot: single-step sets along one drive", folder)


def draw_ring(study: Study, folder: Path) -> list[Path]:
    """The paper's figure of the roundabout: sets without constraints, with φ_r as zonotopes and constrained."""
    path = study.ring[0].position
    figure, axes = _figure(3, 5.0)
    titles = ("none", "φ_r, zonotopes", "φ_r, constrained zonotopes")
    for axis, constrained, title in zip(axes, (None, False, True), titles, strict=True):
        drive, truth = _shown(study.drives(PHI_R, models.as_published_code)[0])
        _draw_place(axis, PHI_R, path)
        _draw_cuts(axis, drive, None if constrained is None else PHI_R, constrained=bool(constrained))
        axis.plot(*truth.T, "k.", markersize=3, zorder=5, label="true next position")
        axis.set_title(f"constraints: {title}")
    return _save(figure, axes, "roundabout", "Roundabout: single-step sets along one drive", folder)


def draw_demonstrations(study: Study, folder: Path) -> list[Path]:
    """What h6 and h7 as printed, and a measured corner, do to T(x)."""
    drive = study.drives(PHI_THETA, models.as_published_code)[0]
    motion = PHI_THETA.motion
    assert motion is not None
    figure, axes = _figure(2, 5.0)
    rows = cuts.motion_as_printed(motion, drive.at)
    lost = ~np.all([row.holds(drive.truth) for row in rows], axis=0)
    left = cuts.printed_motion(drive.sets, PHI_THETA, drive.at, drive.truth).sets
    # The two forms are furthest apart where nothing is left of the printed one; show one that can be drawn.
    step = int(np.flatnonzero(lost & (left.area() > 0.5 * motion.height**2))[0])
    one = _take(drive, np.array([step]))
    meant = _cut(one, PHI_THETA, constrained=True, ours=True)
    printed = cuts.printed_motion(one.sets, PHI_THETA, one.at, one.truth).sets
    draw_sets(axes[0], meant, **_OURS, label="T(x) as meant")
    draw_sets(axes[0], printed, facecolor=("C3", 0.25), edgecolor="C3", label="h6, h7 as printed (UNSOUND)")
    axes[0].set_title("h6, h7 as printed: centers exchanged")
    shift = models.MEASUREMENT_NOISE.T * (-1.0)
    seen = cuts.Situation(one.at.t, one.at.last + shift, one.at.heading, one.at.unknown)
    known = cuts.Situation(one.at.t, one.at.last + shift, one.at.heading, models.MEASUREMENT_NOISE)
    exact = cuts.published_constrained(one.sets, PHI_THETA, seen, one.truth).sets
    boxed = cuts.our_constrained(one.sets, PHI_THETA, known, one.truth).sets
    draw_sets(axes[1], boxed, **_OURS, label="T(x) over the box of Z_v")
    draw_sets(axes[1], exact, facecolor=("C3", 0.25), edgecolor="C3", label="T(x) at the measured position (UNSOUND)")
    axes[1].set_title("T(x) at a measured position: its corner")
    for axis in axes:
        axis.plot(*one.at.last.T, "k+", markersize=8, label="last position")
        axis.plot(*one.truth.T, "k.", markersize=6, label="true next position")
        axis.legend(fontsize=7, loc="best")
    near = one.at.last[0]
    axes[1].set_xlim(near[0] - 0.06, near[0] + 0.06)
    axes[1].set_ylim(near[1] - 0.06, near[1] + 0.06)
    return _save(figure, axes, "demonstrations", "Two demonstrations of unsoundness", folder, legend=False)


def draw_recorded(study: RecordedStudy, folder: Path) -> list[Path]:
    """The scenarios where they were laid over the recording, and the sets there."""
    laid = [one for one in study.laid if one.formula is not None and one.formula.motion is None]
    if not laid:
        return []
    figure, axes = _figure(len(laid), 5.6)
    for axis, one in zip(axes, laid, strict=True):
        assert one.formula is not None
        assert one.placement is not None
        track = one.placement.track(study.recorded.track)
        drive, truth = _shown(study.drive(one))
        _draw_place(axis, one.formula, track.position)
        _draw_cuts(axis, drive, one.formula, constrained=True)
        axis.plot(*truth.T, "k.", markersize=3, zorder=5, label="measured next position")
        axis.set_title(
            f"{one.formula.symbol}: regions × {one.placement.size:.2f}, windows × {one.placement.stretch:.2f}"
        )
    title = f"The scenarios laid over {study.recorded.recording.name}"
    return _save(figure, axes, "recording", title, folder)


def _figure(panels: int, height: float) -> tuple[Figure, Sequence[Axes]]:
    mpl.use("Agg")
    figure = Figure(figsize=(4.6 * panels, height), layout="constrained")
    return figure, figure.subplots(1, panels, squeeze=False)[0]


def _shown(drive: Drive) -> tuple[Drive, FloatArray]:
    """Some steps of a drive, evenly spread, and where the vehicle was then."""
    steps = np.linspace(0, len(drive.truth) - 1, _SHOWN + 2).astype(np.intp)[1:-1]
    taken = _take(drive, steps)
    return taken, taken.truth


def _take(drive: Drive, steps: np.ndarray[tuple[int], np.dtype[np.intp]]) -> Drive:
    mask = np.zeros(len(drive.truth), dtype=bool)
    mask[steps] = True
    return drive.take(mask)


def _cut(drive: Drive, formula: Formula, *, constrained: bool, ours: bool) -> Zonotope | ConstrainedZonotope:
    if ours:
        way = cuts.our_constrained if constrained else cuts.our_zonotopes
    else:
        way = cuts.published_constrained if constrained else cuts.published_zonotopes
    return way(drive.sets, formula, drive.at, drive.truth).sets


def _draw_cuts(axis: Axes, drive: Drive, formula: Formula | None, *, constrained: bool = True) -> None:
    draw_sets(axis, drive.sets, **_UNCUT, label="no constraints")
    if formula is not None:
        draw_sets(axis, _cut(drive, formula, constrained=constrained, ours=False), **_PUBLISHED, zorder=4,
                  label=f"published, Algorithm {3 if constrained else 2}")  # fmt: skip
        draw_sets(axis, _cut(drive, formula, constrained=constrained, ours=True), **_OURS, label="ours")


def _draw_place(axis: Axes, formula: Formula, path: FloatArray) -> None:
    """The regions and the path; strips of the same window are drawn as their intersection."""
    low, high = path.min(axis=0) - _BEYOND, path.max(axis=0) + _BEYOND
    windows: dict[tuple[float, float], list[Strip]] = {}
    for strip in formula.strips:
        windows.setdefault((strip.start, strip.end), []).append(strip)
    for (start, end), strips in windows.items():
        corner, far = low.copy(), high.copy()
        for strip in strips:
            axis_of = int(np.argmax(np.abs(strip.normal)))
            corner[axis_of], far[axis_of] = strip.middle - strip.radius, strip.middle + strip.radius
        axis.add_patch(Rectangle((corner[0], corner[1]), *(far - corner), **_REGION))
        _say_when(axis, (max(corner[0], low[0]) + 0.1, min(far[1], high[1]) - 0.1), start, end)
    for disc in formula.discs:
        axis.add_patch(Circle(disc.center, disc.radius, **_REGION))
        _say_when(axis, _top(disc), disc.start, disc.end)
    axis.plot(*path.T, color="0.4", linewidth=0.8, label="path")
    axis.set_xlim(low[0], high[0])
    axis.set_ylim(low[1], high[1])


def _top(disc: Disc) -> tuple[float, float]:
    return disc.center[0] - 0.4 * disc.radius, disc.center[1] + 0.8 * disc.radius


def _say_when(axis: Axes, at: tuple[float, float], start: float, end: float) -> None:
    axis.text(*at, f"{start:.3g}–{end:.3g} s", fontsize=6.5, color="0.45", va="top")


def _enlarge(axis: Axes, drive: Drive, formula: Formula, step: int) -> None:
    """The sets of one step at the scale of T(x), beside the drive."""
    one = _take(drive, np.array([step % len(drive.truth)]))
    inset = axis.inset_axes((0.62, 0.58, 0.36, 0.40))
    _draw_cuts(inset, one, formula)
    inset.plot(*one.truth.T, "k.", markersize=4, zorder=5)
    assert formula.motion is not None
    middle = 0.5 * formula.motion.diagonal * np.array([np.cos(one.at.heading[0]), np.sin(one.at.heading[0])])
    x, y = one.at.last[0] + middle
    inset.set_xlim(x - 0.45, x + 0.45)
    inset.set_ylim(y - 0.45, y + 0.45)
    inset.set_xticks([])
    inset.set_yticks([])
    inset.set_aspect("equal")
    axis.indicate_inset_zoom(inset, edgecolor="0.3")


def _save(
    figure: Figure, axes: Sequence[Axes], name: str, title: str, folder: Path, *, legend: bool = True
) -> list[Path]:
    for axis in axes:
        axis.set_aspect("equal")
        axis.set_xlabel("x1 [m]")
    axes[0].set_ylabel("x2 [m]")
    figure.suptitle(title)
    if legend:
        shown = {
            label: handle for axis in axes for handle, label in zip(*axis.get_legend_handles_labels(), strict=True)
        }
        figure.legend(shown.values(), shown.keys(), loc="outside lower center", ncols=5, frameon=False, fontsize=8)
    paths = [folder / f"{name}.{form}" for form in _FORMATS]
    for path in paths:
        try:
            figure.savefig(path, dpi=130, metadata={"CreationDate": None} if path.suffix == ".pdf" else None)
        except OSError as error:
            raise UsageError(f"-o {folder}: {path.name} cannot be written: {error}") from None
    return paths
