"""The side information of the paper's two examples as it encodes it, h1 to h7, and placed over other drives.

[AJS+22], section IV. Positions in m, times in s since the start of the drive. The functions are those that the paper
uses: they ask for the gate from 24 s on, where φ_p asks for it at some time until 25 s. A drive that satisfies them
satisfies the formulas, not the other way round.
"""

import math
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from reach_server.numeric.types import FloatArray

# Sample times are multiples of the sample time up to rounding; a window's ends belong to it.
_SAME_INSTANT: Final = 1e-9


@dataclass(frozen=True, slots=True)
class Strip:
    """``|normal·x - middle| <= radius`` for start <= t <= end."""

    name: str
    normal: tuple[float, float]
    middle: float
    radius: float
    start: float
    end: float


@dataclass(frozen=True, slots=True)
class Disc:
    """``|x - center| <= radius`` for start <= t <= end."""

    name: str
    center: tuple[float, float]
    radius: float
    start: float
    end: float


@dataclass(frozen=True, slots=True)
class Motion:
    """T(x): a parallelogram ahead of the vehicle with a corner at its position and sides along heading ± ``turn``.

    ``diagonal`` (m) is the distance from that corner to the opposite one. The paper gives neither number; 0.646 m and
    20° make its table.
    """

    diagonal: float = 0.646
    turn: float = math.radians(20.0)

    @property
    def height(self) -> float:
        """Distance in m of two opposite sides: the side is d/(2 cos θ), and sin 2θ times that is d sin θ."""
        return self.diagonal * math.sin(self.turn)


@dataclass(frozen=True, slots=True)
class Formula:
    """Strips and discs with their windows; with ``motion`` also T(x), at all times.

    ``key`` names it in files, ``symbol`` in tables, ``states`` are those that it speaks about.
    """

    key: str
    symbol: str
    duration: float
    strips: tuple[Strip, ...]
    discs: tuple[Disc, ...] = ()
    motion: Motion | None = None

    def laid_over(self, size: float, stretch: float) -> "Formula":
        """The regions ``size`` times as large about the origin, the windows ``stretch`` times as long; T(x) stays."""

        strips = (
            Strip(s.name, s.normal, s.middle * size, s.radius * size, s.start * stretch, s.end * stretch)
            for s in self.strips
        )
        discs = (
            Disc(d.name, (d.center[0] * size, d.center[1] * size), d.radius * size, d.start * stretch, d.end * stretch)
            for d in self.discs
        )
        return replace(self, duration=self.duration * stretch, strips=tuple(strips), discs=tuple(discs))

    @property
    def parts(self) -> tuple["Strip | Disc", ...]:
        """Strips and discs."""
        return (*self.strips, *self.discs)

    def clearance(self, t: FloatArray, position: FloatArray) -> FloatArray:
        """Least distance (K,) in m of positions (K, 2) at ``t`` (K,) from the border of what holds then, negative
        outside: exact for strips of unit normals and inside discs. T(x) is left out."""
        found = np.full(len(t), np.inf)
        for strip in self.strips:
            inside = strip.radius - np.abs(position @ np.array(strip.normal) - strip.middle)
            found = np.where(active(strip, t), np.minimum(found, inside), found)
        for disc in self.discs:
            inside = disc.radius - np.hypot(*(position - disc.center).T)
            found = np.where(active(disc, t), np.minimum(found, inside), found)
        return found

    def document(self) -> str:
        """The same as a scenario of the product, over x1, x2 (m) and, for T(x), yaw (rad)."""
        asked = {
            part.name: (self._region(part), part.start, part.end)  #
            for part in self.parts
        }
        if self.motion is not None:
            asked |= {name: (text, 0.0, self.duration) for name, text in _motion_regions(self.motion).items()}
        regions = "\n".join(f'  {name}: "{text}"' for name, (text, _, _) in asked.items())
        assumed = " and ".join(f"always[{start!r}:{end!r} s]({name})" for name, (_, start, end) in asked.items())
        states = "{x1: m, x2: m}" if self.motion is None else "{x1: m, x2: m, yaw: rad}"
        return (
            f"scenario: {self.key.replace('_', '-')}\nversion: 1\nstate: {states}\n"
            f"time: {{zero: on_start, semantics: sampled}}\nregions:\n{regions}\nassume: {assumed}\n"
        )

    @staticmethod
    def _region(part: Strip | Disc) -> str:
        if isinstance(part, Disc):
            return f"norm(x1 - ({part.center[0]!r}), x2 - ({part.center[1]!r})) <= {part.radius!r}"
        first, second = part.normal
        return f"abs({first!r} * x1 + {second!r} * x2 - ({part.middle!r})) <= {part.radius!r}"


def _motion_regions(motion: Motion) -> dict[str, str]:
    """T(x) for the next sample. Ahead of the corner is D = a (side along yaw + θ) + b (side along yaw - θ), a and b in
    [0, 1]; with left normals n± of the two sides, n+ D is in [-height, 0] and n- D in [0, height]."""
    ahead = "cos(last(yaw) {0} {1!r}) * (x2 - last(x2)) - sin(last(yaw) {0} {1!r}) * (x1 - last(x1))"
    return {
        "left": f"-{motion.height!r} <= {ahead.format('+', motion.turn)} <= 0",
        "right": f"0 <= {ahead.format('-', motion.turn)} <= {motion.height!r}",
    }


def active(part: Strip | Disc, t: FloatArray) -> NDArray[np.bool_]:
    """Whether a part is asked for at ``t`` (K,), ends included."""
    return (t >= part.start - _SAME_INSTANT) & (t <= part.end + _SAME_INSTANT)


_LOT: Final = (
    Strip("h1", (1.0, 0.0), 0.2805, 1.7175, 0.0, 25.0),
    Strip("h2", (0.0, 1.0), 0.839, 2.429, 0.0, 25.0),
    Strip("h3", (1.0, 0.0), -0.3225, 1.3045, 24.0, 25.0),
    Strip("h4", (0.0, 1.0), -1.137, 0.453, 24.0, 25.0),
    Strip("h5", (0.0, 1.0), -1.665, 1.0, 25.0, 40.0),
)
PHI_P: Final = Formula("phi_p", "φ_p", 40.0, _LOT)
PHI_THETA: Final = Formula("phi_theta", "φ_θ", 40.0, _LOT, motion=Motion())
PHI_R: Final = Formula(
    "phi_r",
    "φ_r",
    14.0,
    (Strip("h1", (0.0, 1.0), 2.25, 1.0, 0.0, 4.0), Strip("h3", (0.0, 1.0), -2.169, 1.0, 10.0, 14.0)),
    (Disc("h2", (0.307, 0.044), 1.429, 4.0, 10.0),),
)
FORMULAS: Final = (PHI_P, PHI_THETA, PHI_R)
