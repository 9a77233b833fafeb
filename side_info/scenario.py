"""A scenario: side information about vehicles, as predicates on windows of time since its time zero."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from importlib import resources
from pathlib import Path
from typing import Any, Final, Self

import numpy as np
from numpy.typing import NDArray

from fleet_bus.errors import ScenarioError
from fleet_bus.messages import VehicleProfile
from side_info.declarations import RESERVED, Declarations
from side_info.document import RegionFields, ScenarioFields, read_fields
from side_info.formula import Formula, parse_excerpt
from side_info.predicates import DiscPredicate, LinearPredicate, Predicate
from side_info.windows import TimedPredicate, timed_predicates, timeless_predicates
from side_info.yaml_text import YamlText, read_yaml

_MAX_SLACK_NS: Final = 2**62


@dataclass(frozen=True, slots=True, eq=False)
class Scenario:
    """A checked scenario document.

    Attributes:
        name: id of the scenario.
        version: of the document, from 1.
        text: the YAML document, to be published.
        state: unit of each state that the formulas name.
        time_zero: nanoseconds since the Unix epoch, or None: each vehicle has its own (``zero: on_start``).
        regions: what each region means; a state lies in it iff all of its predicates hold.
        assume: the side information.
        monitor: requirements by name; they are kept, and nothing evaluates them in this version.
        predicates: what ``assume`` comes to; it holds iff each does at each sample inside of its window.
    """

    name: str
    version: int
    text: str
    state: Mapping[str, str]
    time_zero: int | None
    regions: Mapping[str, tuple[Predicate, ...]]
    assume: Formula
    monitor: Mapping[str, Formula]
    predicates: tuple[TimedPredicate, ...]

    @classmethod
    def parse(cls, text: str, source: str = "scenario") -> Self:
        """Scenario of a YAML document; raise ``ScenarioError`` with ``source``, line, column and a caret."""
        document = read_yaml(text, source)
        fields = read_fields(document)
        _check_names(fields, document)
        regions = _regions(fields, document)
        declared = Declarations(tuple(fields.state), tuple(regions), fields.parameters)
        assume_text = document.excerpt(("assume",))
        assume = parse_excerpt(assume_text, declared)
        monitor: dict[str, Formula] = {}
        for name in fields.monitor:
            monitor_text = document.excerpt(("monitor", name))
            monitor[name] = parse_excerpt(monitor_text, declared)
            timed_predicates(monitor[name], regions, monitor_text)
        return cls(
            fields.scenario,
            fields.version,
            text,
            fields.state,
            fields.time.zero,
            regions,
            assume,
            monitor,
            timed_predicates(assume, regions, assume_text),
        )

    @classmethod
    def load(cls, name_or_path: str | Path) -> Self:
        """Scenario that ships under this name, or of a file; raise ``ScenarioError`` if it cannot be read."""
        if isinstance(name_or_path, str) and name_or_path in shipped():
            text = _SHIPPED.joinpath(f"{name_or_path}.yaml").read_text(encoding="utf-8")
            return cls.parse(text, f"{name_or_path}.yaml")
        try:
            text = Path(name_or_path).read_text(encoding="utf-8")
        except (OSError, ValueError) as error:
            raise ScenarioError(
                f"{name_or_path!s:.200}: cannot be read: {error}; expected a file or one of {', '.join(shipped())}"
            ) from None
        return cls.parse(text, str(name_or_path))

    @property
    def end_ns(self) -> int:
        """Nanoseconds after time zero from which on nothing is known any more."""
        return max(timed.end_ns for timed in self.predicates)

    def active(
        self, tau_ns: NDArray[np.integer[Any]] | int, slack_ns: NDArray[np.integer[Any]] | int = 0
    ) -> NDArray[np.bool_]:
        """Which of the P predicates surely hold at times ``tau_ns`` (...,) after time zero: (..., P).

        ``slack_ns`` bounds by how much ``tau_ns`` may be wrong, and broadcasts with it. True where
        ``start_ns + slack_ns <= tau_ns <= end_ns - slack_ns``: there the predicate is active whatever the
        error is. Everywhere else it is left out, which can only enlarge a set. Exact in whole nanoseconds.

        Raises ``ValueError`` for what are no integers, or a slack that is negative or of more than 2^62 ns.
        """
        tau, slack = np.asarray(tau_ns), np.asarray(slack_ns)
        if tau.dtype.kind not in "iu" or slack.dtype.kind not in "iu":
            raise ValueError(f"times are integers of nanoseconds, {tau.dtype} and {slack.dtype} came")
        if (slack < 0).any() or (slack > _MAX_SLACK_NS).any():
            raise ValueError("slack_ns must lie between 0 and 2^62")
        tau, slack = tau.astype(np.int64)[..., None], slack.astype(np.int64)[..., None]
        start = np.array([timed.start_ns for timed in self.predicates], dtype=np.int64)
        end = np.array([timed.end_ns for timed in self.predicates], dtype=np.int64)
        inside: NDArray[np.bool_] = (start + slack <= tau) & (tau <= end - slack)
        return inside

    def state_indices(self, profile: VehicleProfile) -> dict[str, int]:
        """Index in the state of ``profile`` of each state of this scenario; ``maps_to`` before equal names.

        Raises ``ScenarioError`` if one has no counterpart or another unit there, or if a predicate speaks
        about an angle: a vehicle that has turned once is 2π away from where the predicate looks for it.
        """
        indices = {}
        constrained = {state for timed in self.predicates for state in timed.predicate.states}
        for name, unit in self.state.items():
            target = profile.maps_to.get(name, name)
            if target not in profile.state:
                raise ScenarioError(
                    f"scenario {self.name}: its state {name!r} is no state of class {profile.vehicle_class} "
                    f"({', '.join(profile.state)}): name its counterpart in the profile's maps_to"
                )
            spec = profile.state[target]
            if spec.unit != unit:
                raise ScenarioError(
                    f"scenario {self.name}: its state {name!r} is in {unit}, "
                    f"{target!r} of class {profile.vehicle_class} in {spec.unit}: expected the same unit"
                )
            if spec.angle and name in constrained:
                raise ScenarioError(
                    f"scenario {self.name}: {target!r} of class {profile.vehicle_class} is an angle; "
                    "predicates about angles are not supported in this version"
                )
            indices[name] = profile.state_names.index(target)
        return indices


_SHIPPED: Final = resources.files("side_info").joinpath("scenarios")


def shipped() -> tuple[str, ...]:
    """Names of the scenarios that ship with the package."""
    return tuple(
        sorted(entry.name.removesuffix(".yaml") for entry in _SHIPPED.iterdir() if entry.name.endswith(".yaml"))
    )


def _check_names(fields: ScenarioFields, document: YamlText) -> None:
    """Raise ``ScenarioError`` if a name is a word of the language or has two meanings."""
    meanings: dict[str, str] = {}
    for kind, names in (
        ("state", fields.state),
        ("parameters", fields.parameters),
        ("regions", fields.regions),
    ):
        for name in names:
            if name in RESERVED:
                raise document.error((kind, name), f"{name!r} is a word of the language: choose another name", key=True)
            if name in meanings:
                raise document.error((kind, name), f"{name!r} is already declared under {meanings[name]}", key=True)
            meanings[name] = kind


def _regions(fields: ScenarioFields, document: YamlText) -> dict[str, tuple[Predicate, ...]]:
    regions: dict[str, tuple[Predicate, ...]] = {}
    for name, region in fields.regions.items():
        if region.text is not None:
            regions[name] = _text_region(name, fields, regions, document)
        else:
            regions[name] = _shape_region(name, region, fields, document)
    return regions


def _text_region(
    name: str, fields: ScenarioFields, regions: Mapping[str, tuple[Predicate, ...]], document: YamlText
) -> tuple[Predicate, ...]:
    """Region of a formula, which may name the regions above it."""
    path = ("regions", name)
    excerpt = document.excerpt(path if isinstance(document.fields["regions"][name], str) else (*path, "text"))
    formula = parse_excerpt(excerpt, Declarations(tuple(fields.state), tuple(regions), fields.parameters))
    predicates = timeless_predicates(formula, regions, excerpt)
    if len(predicates) == 1:
        return (replace(predicates[0], name=name),)
    return tuple(replace(predicate, name=f"{name}.{k}") for k, predicate in enumerate(predicates, 1))


def _shape_region(name: str, region: RegionFields, fields: ScenarioFields, document: YamlText) -> tuple[Predicate, ...]:
    path: tuple[str, ...] = ("regions", name, "box")
    axes: Mapping[str, object] = region.box or {}
    if region.disc is not None:
        path, axes = ("regions", name, "disc", "center"), region.disc.center
    for state in axes:
        if state not in fields.state:
            raise document.error(
                (*path, state),
                f"{state!r} is not declared: expected a state of {', '.join(fields.state)}",
                key=True,
            )
    if region.disc is not None:
        return (DiscPredicate(name, region.disc.center, region.disc.radius),)
    box = region.box or {}
    for state, (lower, upper) in box.items():
        if lower > upper:
            raise document.error((*path, state), f"the bounds are reversed: {lower:g} > {upper:g}")
    return tuple(LinearPredicate(f"{name}.{state}", {state: 1.0}, *bounds) for state, bounds in box.items())
