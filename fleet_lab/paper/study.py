"""The study part by part: what is computed, of which drives, and how it is labelled."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cached_property, partial
from typing import Final

import numpy as np

from fleet_lab.paper import cells, cuts, models, runtime
from fleet_lab.paper.cells import KINDS, NONE, NONE_RING, PRINTED, Block, Cell, Cut, Drive
from fleet_lab.paper.drives import Data, Track, displacement_error, history, simulate
from fleet_lab.paper.formulas import FORMULAS, PHI_R, PHI_THETA, Formula
from reach_server.numeric.types import FloatArray
from reach_server.sets import Zonotope
from vehicle_agent.route import load_route

#: Drives of each example.
DRIVES: Final = 4
Tell = Callable[[float], None]
Uncut = Callable[[Data, FloatArray, FloatArray], Zonotope]

PUBLISHED: Final[dict[str, Cut]] = {"zonotope": cuts.published_zonotopes, "constrained": cuts.published_constrained}
OURS: Final[dict[str, Cut]] = {"zonotope": cuts.our_zonotopes, "constrained": cuts.our_constrained}
_NOTHING: Final = np.zeros((2, 0))


class Study:
    """The simulated part of ``fleet paper``; everything follows from ``seed``."""

    def __init__(self, seed: int) -> None:
        self.seed = seed

    @cached_property
    def before(self) -> list[Track]:
        """The drives that the data come from."""
        return history(self.seed)

    @cached_property
    def lot(self) -> list[Track]:
        """Drives that satisfy φ_θ, and so φ_p."""
        return [simulate(PHI_THETA, self._seed(i)) for i in range(DRIVES)]

    @cached_property
    def ring(self) -> list[Track]:
        """Drives that satisfy φ_r."""
        return [simulate(PHI_R, self._seed(i)) for i in range(DRIVES)]

    def _seed(self, drive: int) -> int:
        return self.seed * DRIVES + drive

    def tracks(self, formula: Formula) -> list[Track]:
        """The drives of a formula."""
        return self.ring if formula.discs else self.lot

    def drives(self, formula: Formula, uncut: Uncut) -> list[Drive]:
        """Their steps, with exact positions, as ``uncut`` computes the sets."""
        data = Data.of(self.before)
        return [drive_of(track, data, uncut) for track in self.tracks(formula)]

    def printed(self, tell: Tell) -> Block:
        """The tables as they stand in the paper."""
        found = [Cell(formula, kind, area, 9.722, printed=area) for (formula, kind), area in PRINTED.items()]
        return Block("printed", "Printed", "Tables I and II of the paper, m².", tuple(found))

    def published_code(self, tell: Tell) -> Block:
        """What makes the printed numbers."""
        notes = {
            ("phi_p", "zonotope"): "larger than no cut; it does not depend on where the car is. 9.311 is not reached",
            ("phi_r", "zonotope"): "the remainder that the text asks for is left out: see the next block",
        }
        note = (
            "-Z_w boxed in line 4 of Algorithm 1, neither Z_ε nor Z_v; Algorithms 2 and 3; the disc linearised without "
            "remainder, which is sound only because the norm is convex."
        )
        return self._table(
            tell, "published_code", "As the published code", note, models.as_published_code, PUBLISHED, notes
        )

    def printed_text(self, tell: Tell) -> Block:
        """What the text says."""
        data = Data.of(self.before)
        algorithm = models.printed(data)
        note = (
            "Z_w is one segment, so the sets are thin: of another kind than the printed numbers. Z_ε with L* = "
            f"{algorithm.lipschitz:.3g} and δ = {algorithm.radius:.3g} m as the data show them; no Z_v. The remainder "
            "of the disc is infinite where its center may be in the set: there it does not cut."
        )
        ways: dict[str, Cut] = {
            "zonotope": partial(cuts.published_zonotopes, remainder=True),
            "constrained": partial(cuts.published_constrained, remainder=True),
        }
        return self._table(
            tell, "printed_text", "As the printed text", note, models.as_printed, ways, {}, compared=False
        )

    def ours(self, tell: Tell) -> Block:
        """Better cuts of the same sets."""
        note = (
            "The sets of the published code; strips tightened to the set and the best of several λ, exact clipping, "
            "tangents of the disc."
        )
        return self._table(
            tell, "ours", "Ours, on the same sets", note, models.as_published_code, OURS, {}, cuts.published_zonotopes
        )

    def ours_with_noise(self, tell: Tell) -> Block:
        """The same with measured positions."""
        note = (
            "Data and last position carry the paper's measurement noise Z_v = <0, [0.01 0.01]ᵀ>; it goes through the "
            "model (R_0, N = -Z_w - Z_v + A Z_v), and T(x) holds for a corner anywhere in Z_v. Not the sets of the "
            "printed numbers. Z_ε is left out here, too: f is linear up to process noise."
        )
        rng = np.random.default_rng(self.seed)
        data = Data.of([measured(track, rng) for track in self.before])
        found: list[Cell] = []
        for formula in FORMULAS:
            drives = [noisy_drive(track, data, rng) for track in self.tracks(formula)]
            if formula is not PHI_THETA:
                found.append(cells.uncut_cell(drives, none_of(formula), None))
            found += [cells.cut_cell(drives, formula, kind, OURS[kind], cuts.published_zonotopes) for kind in KINDS]
        return Block("ours_with_noise", "Ours, with N and Z_v", note, tuple(found))

    def ours_realistic(self, tell: Tell) -> Block:
        """The reach server with noise that fits the car."""
        note = (
            "The engine of the reach server (set membership, label in the last column), with bounds that such a car "
            f"has: {1e3 * displacement_error():.1f} mm of process noise, positions measured to "
            f"{1e3 * runtime.MEASURED[0]:.0f} mm, the velocity in force known exactly as in the other blocks. Side "
            "information about regions of metres cuts sets of millimetres only near a border: the gains of the tables "
            f"exist because 0.9 m are assumed. Every {runtime.STRIDE}th sample is predicted."
        )
        found: list[Cell] = []
        done = 0
        for formula in FORMULAS:
            outcomes = {}
            for way in ("zonotope", "constrained", "frobenius"):
                outcomes[way] = runtime.drive(
                    formula, self.tracks(formula), self.before, self.seed, way,
                    lambda k, n, done=done: tell((done + k / n) / 9),  # type: ignore[misc]
                )  # fmt: skip
                done += 1
            if formula is not PHI_THETA:
                found.append(_engine_cell(none_of(formula), "zonotope", outcomes["zonotope"], uncut=True))
            other = outcomes["frobenius"].area
            found += [_engine_cell(formula.key, kind, outcomes[kind], algorithm_2=other) for kind in KINDS]
        return Block("ours_realistic", "Ours, with realistic noise", note, tuple(found))

    def demonstrations(self, tell: Tell) -> Block:
        """What loses the vehicle."""
        drives = self.drives(PHI_THETA, models.as_published_code)
        found = [
            cells.counted_cell(
                drives, PHI_THETA, cuts.printed_motion,
                "UNSOUND: h6 and h7 as printed, the centers of the two strips exchanged",
            )
        ]  # fmt: skip
        rng = np.random.default_rng(self.seed)
        box = lambda count: rng.uniform(-0.001, 0.001, (count, 2))  # noqa: E731
        segment = lambda count: rng.uniform(-1.0, 1.0, (count, 1)) * models.MEASUREMENT_NOISE.T  # noqa: E731
        for text, draw in (("1 mm", box), ("the paper's Z_v", segment)):
            noisy = [replace(d, at=replace(d.at, last=d.at.last + draw(len(d.truth)))) for d in drives]
            found.append(
                cells.counted_cell(
                    noisy, PHI_THETA, cuts.published_constrained,
                    f"UNSOUND: T(x) with its corner at a position measured with an error of {text}, taken as exact",
                )
            )  # fmt: skip
        note = (
            "Marked on purpose: true states outside of their set. What was meant, and T(x) over the box of Z_v, stand "
            "in the blocks above, with none outside."
        )
        return Block("demonstrations", "Two demonstrations of unsoundness", note, tuple(found), unsound=True)

    def routes(self, tell: Tell) -> Block:
        """How much the constrained cells owe to where the car drives."""
        data, found = Data.of(self.before), []
        for formula, route in ((FORMULAS[0], "parking-lot"), (PHI_R, "roundabout")):
            tracks = [simulate(formula, self._seed(i), load_route(route)) for i in range(DRIVES)]
            drives = [drive_of(track, data, models.as_published_code) for track in tracks]
            found += [
                cells.cut_cell(
                    drives, formula, kind, PUBLISHED[kind], printed=PRINTED[formula.key, kind],
                    note=f"route {route} of the demonstration, which keeps near the borders",
                )
                for kind in KINDS
            ]  # fmt: skip
        note = (
            "As the published code, but on other drives that satisfy the same formulas. The way points of the drives "
            "above were chosen so that the constrained cell of φ_p is near the printed one; Algorithm 2's areas hardly "
            "depend on the drive, Algorithm 3's do."
        )
        return Block("routes", "The same on other drives", note, tuple(found))

    def _table(
        self,
        tell: Tell,
        key: str,
        title: str,
        note: str,
        uncut: Uncut,
        ways: dict[str, Cut],
        notes: dict[tuple[str, str], str],
        algorithm_2: Cut | None = None,
        *,
        compared: bool = True,
    ) -> Block:
        found: list[Cell] = []
        for formula in FORMULAS:
            tell(len(found) / (2 + 2 * len(FORMULAS)))
            drives = self.drives(formula, uncut)
            if formula is not PHI_THETA:
                none = none_of(formula)
                found.append(cells.uncut_cell(drives, none, PRINTED[none, "zonotope"] if compared else None))
            found += [
                cells.cut_cell(
                    drives, formula, kind, ways[kind], algorithm_2,
                    printed=PRINTED[formula.key, kind] if compared else None, note=notes.get((formula.key, kind), ""),
                )
                for kind in KINDS
            ]  # fmt: skip
        return Block(key, title, note, tuple(found))


def drive_of(track: Track, data: Data, uncut: Uncut, unknown: FloatArray = _NOTHING) -> Drive:
    """The steps of a track; positions as they are, for T(x) known up to ``unknown`` (2, g)."""
    x, u = track.position[:-1], track.velocity[:-1]
    at = cuts.Situation(track.t[1:], x, track.heading[:-1], unknown)
    return Drive(uncut(data, x, u), at, track.position[1:])


def measured(track: Track, rng: np.random.Generator) -> Track:
    """A track whose positions carry an error from the paper's Z_v."""
    return replace(track, position=track.position + rng.uniform(-1, 1, (len(track.t), 1)) * models.MEASUREMENT_NOISE.T)


def noisy_drive(track: Track, data: Data, rng: np.random.Generator) -> Drive:
    """The steps of a track whose positions are measured; the true ones are what is checked."""
    seen = drive_of(measured(track, rng), data, models.with_noise, models.MEASUREMENT_NOISE)
    return replace(seen, truth=track.position[1:])


def none_of(formula: Formula) -> str:
    """The key of the cell without constraints for the drives of a formula."""
    return NONE_RING if formula.discs else NONE


def _engine_cell(
    formula: str, kind: str, outcome: runtime.Outcome, *, uncut: bool = False, algorithm_2: FloatArray | None = None
) -> Cell:
    area, inside = (outcome.area_free, outcome.inside_free) if uncut else (outcome.area, outcome.inside)
    vehicles = len(area)
    return Cell(
        formula, kind, float(area.mean()), float(outcome.area_free.mean()), _means(area),
        None if algorithm_2 is None else float(algorithm_2.mean()),
        int(np.count_nonzero(~inside)), inside.size,
        None if uncut else float(np.median(outcome.seconds)) / vehicles * 1e6, None, ", ".join(outcome.labels),
        None if uncut else cells.most(list(area), list(outcome.area_free)),
        None if algorithm_2 is None else cells.most(list(area), list(algorithm_2)),
    )  # fmt: skip


def _means(area: FloatArray) -> tuple[float, ...]:
    return tuple(float(row.mean()) for row in area)


def parts(study: Study) -> Sequence[tuple[str, Callable[[Tell], Block]]]:
    """What is computed of the simulated drives, in order."""
    return (
        ("the printed tables", study.printed),
        ("as the published code", study.published_code),
        ("as the printed text", study.printed_text),
        ("ours, on the same sets", study.ours),
        ("ours, with N and Z_v", study.ours_with_noise),
        ("demonstrations", study.demonstrations),
        ("other drives", study.routes),
        ("ours, with realistic noise", study.ours_realistic),
    )
