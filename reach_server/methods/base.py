"""The interface of a method that computes reachable sets from data."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from fleet_bus.messages import Lipschitz
from reach_server.data.window import Block
from reach_server.methods.request import PlannedInputs, TubeRequest
from reach_server.models.residual_model import NoiseBounds
from reach_server.numeric.types import FloatArray, IndexArray
from reach_server.sets.raw import RawSets
from reach_server.tube.branching import Motion
from reach_server.tube.cut_schedule import CutSchedule
from reach_server.tube.unbranched import UnbranchedTubes

#: Which vehicles (B,) cannot be served, and why.
Reason = tuple[NDArray[np.bool_], str]


@dataclass(frozen=True, slots=True, eq=False)
class Outlook:
    """Limits of the sets of B vehicles besides their models.

    ``unseen`` (B, n + m): states and inputs of which what enters the model lies outside the data. ``low`` and ``high``
    (B, N, n): stated bounds of what the sets speak about, at steps 1 to N, infinite where there are none; None where
    the profile states none. ``held`` (B, 2): sets were cut already by stated bounds, by observed ones.
    """

    unseen: NDArray[np.bool_]
    held: NDArray[np.bool_]
    low: FloatArray | None = None
    high: FloatArray | None = None


class Forecast(Protocol):
    """The sets of B requested vehicles over the horizon."""

    @property
    def outlook(self) -> Outlook:
        """The limits of the sets besides the models."""

    @property
    def start(self) -> RawSets:
        """The sets (B, n) of now."""

    @property
    def motion(self) -> Motion:
        """The motion that moves the sets step by step."""

    def ahead(self) -> tuple[FloatArray, FloatArray] | None:
        """Centers (B, N + 1, n) and generators (B, N + 1, n, g) of the sets without cuts at steps 0 to N, if they do
        not depend on cuts, else None."""

    def unbranched(self, rows: IndexArray, schedule: CutSchedule) -> UnbranchedTubes | None:
        """The tubes of the vehicles of some rows (K,), cut by the schedule (K), in one loop; None if the method has
        none."""


class Method(Protocol):
    """Models of the vehicles of a class, by slot, and how sets follow from them; ``slots`` (B,) name the vehicles asked
    about."""

    @property
    def claims_measured(self) -> bool:
        """Whether the sets speak about measured states, rather than true ones."""

    @property
    def bounds(self) -> NoiseBounds:
        """The stated noise, in the frame of the model."""

    @property
    def lipschitz(self) -> Lipschitz | None:
        """The stated bounds of derivatives that the method can use."""

    @property
    def samples_needed(self) -> int:
        """How many of the newest samples ``reasons`` and ``forecast`` want to see."""

    @property
    def notes(self) -> tuple[str, ...]:
        """The notes of every tube of this method."""

    #: Whether nothing is learned any more.
    frozen: bool

    def grow(self, slots: int) -> None:
        """Make room for ``slots`` vehicles."""

    def reset(self, slot: int) -> None:
        """Forget what was learned of one vehicle."""

    def learn(self, slots: IndexArray) -> None:
        """Update some vehicles with their new samples, and fit those that are due."""

    def missing(self, slots: IndexArray) -> NDArray[np.int64]:
        """How many samples more some vehicles (B,) need before they have a model; 0 where they have one."""

    def reasons(self, slots: IndexArray, block: Block, known: PlannedInputs | None) -> list[Reason]:
        """Reasons why some of the vehicles (B,), which have models, cannot be predicted now."""

    def glitches(self) -> list[tuple[int, int]]:
        """Slots of vehicles of which a sample turned out to be a glitch since the last call, each with the stamp of the
        sample that revealed it."""

    def rank_deficient(self, slots: IndexArray) -> NDArray[np.bool_]:
        """For which of the requested vehicles the data does not determine the model."""

    def forecast(self, request: TubeRequest) -> Forecast:
        """The sets of some vehicles over the horizon."""
