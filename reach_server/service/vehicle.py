"""What a server knows of one vehicle beside its data: its writer, its profiles, what waits, its clock."""

from dataclasses import dataclass, field
from typing import Final

from fleet_bus.messages import StateBatch, VehicleProfile
from fleet_bus.writers import Writer
from reach_server.engine.engine import Engine
from reach_server.service.clock_offsets import ClockOffset
from reach_server.service.sample_rows import Plan

#: Samples of a vehicle that are kept while its profile, or the decision about its writer, has not come.
MOST_KEPT: Final = 2000
#: Profiles of one vehicle, from different sessions, that are kept until one of these writes its states.
MOST_OFFERED: Final = 4
#: Seconds after which a silent writer may be followed by another, and after which one of two has left; and sample
#: intervals that both are at least.
PATIENCE: Final = 0.5
LEAVE: Final = 2.0
INTERVALS: Final = 5.0


@dataclass(slots=True)
class Vehicle:
    """One vehicle: ``engine`` and ``slot`` once it has a profile and samples.

    ``kept`` are samples that wait for a profile, ``held`` those of another source that may follow the writer;
    ``offered`` the profiles by session, of which ``profile`` is in force; ``awaits_profile``: the writer has not sent
    one yet. ``heard`` (s) is when its newest sample came, ``seen`` (s) when anything did, ``gone`` whether it has left,
    ``kept_since`` (s) when the first sample that is kept did.
    """

    profile: VehicleProfile | None = None
    profile_source: str = ""
    awaits_profile: bool = False
    engine: Engine | None = None
    slot: int = -1
    kept: list[StateBatch] = field(default_factory=list)
    kept_since: float = 0.0
    held: list[StateBatch] = field(default_factory=list)
    told: set[str] = field(default_factory=set)
    plan: Plan | None = None
    first: tuple[int, int] | None = None
    writer: Writer = field(default_factory=Writer)
    offered: dict[str, VehicleProfile] = field(default_factory=dict)
    #: Session of a profile that is not the writer's, and how many samples of the writer have come since.
    foreign: tuple[str, int] | None = None
    clock: ClockOffset = field(default_factory=ClockOffset)
    heard: float = -float("inf")
    seen: float = -float("inf")
    gone: bool = False

    @property
    def patience(self) -> float:
        """Seconds of silence after which another source may follow."""
        return max(PATIENCE, INTERVALS * (0.0 if self.profile is None else self.profile.sample_time))

    @property
    def leave(self) -> float:
        """Seconds of silence after which one of two sources has left."""
        return max(LEAVE, 2 * self.patience)

    @property
    def served(self) -> VehicleProfile | None:
        """The profile in force, if it is that of the writer."""
        return None if self.awaits_profile else self.profile

    def offer(self, session: str, profile: VehicleProfile) -> None:
        """Keep a profile for the case that its session writes the vehicle's states."""
        self.offered.pop(session, None)
        while len(self.offered) >= MOST_OFFERED:
            writer = self.writer.source
            del self.offered[next(s for s in self.offered if writer is None or s != writer.session)]
        self.offered[session] = profile

    def writes(self, session: str) -> bool:
        """Whether a profile of some session is to be believed: nobody can tell that of states without a name."""
        writer = self.writer.source
        if writer is None or not writer.session:
            return self.profile is None or session == self.profile_source
        return session == writer.session

    def note_first(self, states: StateBatch) -> None:
        """Remember (epoch, seq) of the first sample of the newest epoch."""
        newest = states.epoch.max()
        found = int(newest), int(states.seq[states.epoch == newest].min())
        if self.first is None or found[0] > self.first[0] or (found[0] == self.first[0] and found[1] < self.first[1]):
            self.first = found

    def keep(self, states: StateBatch, now: float) -> int:
        """Keep samples, the newest ``MOST_KEPT``; how many were dropped for them."""
        if not self.kept:
            self.kept_since = now
        self.kept.append(states)
        return _trim(self.kept)

    def hold(self, states: StateBatch) -> int:
        """Hold samples of another source; how many were dropped for them."""
        self.held.append(states)
        return _trim(self.held)

    def drop_held(self) -> int:
        """Forget the samples of another source; how many there were."""
        number = sum(len(states.t) for states in self.held)
        self.held.clear()
        return number

    def follow(self) -> None:
        """Begin with the samples that were held of the source that writes now."""
        self.kept = [*self.held, *self.kept]
        self.held = []
        self.told, self.plan, self.first, self.foreign = set(), None, None, None
        self.clock = ClockOffset()


def _trim(kept: list[StateBatch]) -> int:
    dropped = 0
    while len(kept) > 1 and sum(len(states.t) for states in kept) > MOST_KEPT:
        dropped += len(kept.pop(0).t)
    return dropped
