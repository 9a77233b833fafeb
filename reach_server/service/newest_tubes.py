"""What the newest tube of each vehicle claims, or why there is none."""

from collections import Counter

from fleet_bus.messages import Label
from reach_server.engine.results import Tubes


class NewestTubes:
    """``labels`` of the newest tubes by vehicle, and ``waiting``: why other vehicles have none."""

    def __init__(self) -> None:
        self.labels: dict[str, Label] = {}
        self.waiting: dict[str, str] = {}

    def see(self, tubes: Tubes) -> None:
        """Take in the tubes of a round."""
        for vehicle in tubes.vehicles:
            self.waiting.pop(vehicle, None)
        self.waiting |= tubes.waiting
        for vehicle in tubes.waiting:
            self.labels.pop(vehicle, None)
        self.labels.update(zip(tubes.vehicles, tubes.labels, strict=True))

    def forget(self, vehicle: str) -> None:
        """A vehicle is gone, or not known any more."""
        self.waiting.pop(vehicle, None)
        self.labels.pop(vehicle, None)

    def by_label(self) -> dict[Label, int]:
        """How many vehicles have a newest tube of each label."""
        found = Counter(self.labels.values())
        return {label: found[label] for label in Label}
