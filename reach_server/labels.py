"""What a tube may claim: its label and the notes to it."""

import numpy as np
from numpy.typing import NDArray

from fleet_bus.messages import Label, Lipschitz, VehicleProfile


class Labels:
    """Labels of the tubes of a class.

    ``guaranteed`` where the user states every bound that the method rests on; ``calibrated`` where these come from
    data, and for the method of that name; ``uncovered`` where one is missing, so that nothing is claimed;
    ``contradicted`` where the record of a vehicle says that the label was wrong: a miss of a guaranteed set or data
    that excludes the bounds, until these have held for long enough since; a pose that jumps again and again; or more
    misses than the confidence of calibrated sets explains (docs: concepts/guarantees).
    """

    def __init__(
        self, profile: VehicleProfile, method: str, lipschitz: Lipschitz | None, notes: tuple[str, ...] = ()
    ) -> None:
        noise = profile.noise
        parts = [noise.process, noise.measurement] + ([lipschitz] if method != "lti" else [])
        self._received_bounded = noise.measurement is not None and noise.measurement.origin == "given"
        if method == "calibrated":
            self._label = Label.CALIBRATED
        elif any(part is None for part in parts):
            self._label = Label.UNCOVERED
        elif all(part is not None and part.origin == "given" for part in parts):
            self._label = Label.GUARANTEED
        else:
            self._label = Label.CALIBRATED
        self._always = notes

    @property
    def certain(self) -> bool:
        """Whether a single miss proves a bound wrong."""
        return self._label is Label.GUARANTEED

    @property
    def audited(self) -> bool:
        """Whether misses are held against a confidence."""
        return self._label is Label.CALIBRATED

    def of(self, wrong: NDArray[np.bool_]) -> tuple[Label, ...]:
        """Labels of vehicles, of which some records (B,) say that their label is wrong."""
        if not wrong.any():
            return (self._label,) * len(wrong)
        return tuple(Label.CONTRADICTED if w else self._label for w in wrong.tolist())

    def of_limits(self, count: int) -> tuple[Label, ...]:
        """Labels of ``count`` tubes from limits alone, which the user states."""
        return (Label.GUARANTEED if self._received_bounded else Label.UNCOVERED,) * count

    def notes(
        self, deficient: NDArray[np.bool_], contradicted: NDArray[np.bool_], emptied: NDArray[np.bool_]
    ) -> tuple[tuple[str, ...], ...]:
        """Notes of vehicles (B,): whose data is rank deficient, whose side information is, or leaves nothing."""
        if not (deficient.any() or contradicted.any() or emptied.any()):
            return (self._always,) * len(deficient)
        found = []
        for bad, against, nothing in zip(deficient.tolist(), contradicted.tolist(), emptied.tolist(), strict=True):
            notes = ("rank deficient",) * bad + self._always
            if against:
                notes += ("side information contradicted",)
            elif nothing:
                notes += ("side information left nothing",)
            found.append(notes)
        return tuple(found)
