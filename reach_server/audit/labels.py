"""The label of a tube, which says what it claims, and its notes."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from fleet_bus.messages import Label, Lipschitz, VehicleProfile
from reach_server.data.observed_range import MARGIN

#: Notes: what enters the model lies outside the data, of these states and inputs;
OUTSIDE = "outside the data"
#: sets were cut by stated limits, and by ``MARGIN`` times the greatest changes observed where none are stated.
HELD = ("within stated limits", f"within {MARGIN:g} times the fastest change seen")


@dataclass(frozen=True, slots=True)
class Claim:
    """What the sets of a method claim: a ``rate`` at which measured states lie in them, or that true states always do
    as long as the ``bounds`` named are true; with neither, nothing."""

    rate: bool = False
    bounds: tuple[Literal["process", "measurement", "lipschitz"], ...] = ()


#: What a method claims that does not say so.
NOTHING = Claim()


class Labels:
    """Labels of the tubes of a class.

    ``guaranteed`` where the user states every bound that the method rests on; ``calibrated`` where these come from
    data, and for the method of that name, while what enters the model is like the data; ``uncovered`` where it is not,
    or a bound is missing, so that nothing is claimed;
    ``contradicted`` where the record of a vehicle says that the label was wrong: a miss of a guaranteed set or data
    that excludes the bounds, until these have held for long enough since; a pose that jumps again and again; more
    misses than the confidence of calibrated sets explains (docs: concepts/guarantees). What two sources publish is
    marked so by the service.
    """

    def __init__(
        self, profile: VehicleProfile, claim: Claim, lipschitz: Lipschitz | None, notes: tuple[str, ...] = ()
    ) -> None:
        noise = profile.noise
        stated = {"process": noise.process, "measurement": noise.measurement, "lipschitz": lipschitz}
        parts = [stated[name] for name in claim.bounds]
        self._received_bounded = noise.measurement is not None and noise.measurement.origin == "given"
        if claim.rate:
            self._label = Label.CALIBRATED
        elif not parts or any(part is None for part in parts):
            self._label = Label.UNCOVERED
        elif all(part is not None and part.origin == "given" for part in parts):
            self._label = Label.GUARANTEED
        else:
            self._label = Label.CALIBRATED
        self._always = notes
        self._names = (*profile.state, *profile.inputs)

    @property
    def certain(self) -> bool:
        """Whether a single miss proves a bound wrong."""
        return self._label is Label.GUARANTEED

    @property
    def audited(self) -> bool:
        """Whether misses are held against a confidence."""
        return self._label is Label.CALIBRATED

    def unclaimed(self, outside: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Of which vehicles (B,) nothing is claimed because they are ``outside`` (B,) the data: a rate is one of errors
        like those on record, which theirs need not be; stated bounds hold everywhere."""
        return outside if self.audited else np.zeros_like(outside)

    def of(self, wrong: NDArray[np.bool_], unclaimed: NDArray[np.bool_]) -> tuple[Label, ...]:
        """Labels of vehicles, of which some records (B,) say that their label is wrong, and some are ``unclaimed``
        (B,)."""
        if not (wrong.any() or unclaimed.any()):
            return (self._label,) * len(wrong)
        bad = Label.CONTRADICTED, Label.UNCOVERED, self._label
        return tuple(bad[0] if w else bad[1] if u else bad[2] for w, u in zip(wrong, unclaimed, strict=True))

    def of_limits(self, count: int) -> tuple[Label, ...]:
        """Labels of ``count`` tubes from limits alone, which the user states."""
        return (Label.GUARANTEED if self._received_bounded else Label.UNCOVERED,) * count

    def notes(
        self, deficient: NDArray[np.bool_], contradicted: NDArray[np.bool_], emptied: NDArray[np.bool_],
        unseen: NDArray[np.bool_], held: NDArray[np.bool_],
    ) -> tuple[tuple[str, ...], ...]:  # fmt: skip
        """Notes of vehicles (B,): whose data is rank deficient, whose side information is contradicted, or leaves
        nothing; of which states and inputs are ``unseen`` (B, n + m), and whose sets were ``held`` (B, 2) within stated
        and observed bounds."""
        some = deficient | contradicted | emptied | unseen.any(axis=1) | held.any(axis=1)
        if not some.any():
            return (self._always,) * len(deficient)
        found = [self._always] * len(deficient)
        for row in np.flatnonzero(some).tolist():
            bad, against, nothing = bool(deficient[row]), bool(contradicted[row]), bool(emptied[row])
            notes = ("rank deficient",) * bad + self._always
            if unseen[row].any():
                names = [self._names[i] for i in np.flatnonzero(unseen[row]).tolist()]
                notes += (f"{OUTSIDE}: {', '.join(names)}",)
            notes += tuple(note for note, cut in zip(HELD, held[row].tolist(), strict=True) if cut)
            if against:
                notes += ("side information contradicted",)
            elif nothing:
                notes += ("side information left nothing",)
            found[row] = notes
        return tuple(found)
