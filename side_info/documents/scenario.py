"""A scenario: what is known about vehicles, and what is asked of them, as formulas over time since its time zero."""

from collections.abc import Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from importlib import resources
from pathlib import Path
from typing import Final, Literal, Self

from fleet_bus.errors import ScenarioError
from fleet_bus.messages import VehicleProfile
from side_info.documents.document import ScenarioFields, read_fields
from side_info.documents.document_files import read_document
from side_info.documents.scenario_text import ScenarioText
from side_info.documents.yaml_text import YamlText, read_yaml
from side_info.stl.angles import misused_angle
from side_info.stl.ast import Formula
from side_info.stl.expression import Last, Steps, nodes_of
from side_info.stl.nnf import Normal, reach_ns
from side_info.stl.normal_form import literals_in
from side_info.stl.predicates import NonlinearPredicate, Predicate


@dataclass(frozen=True, slots=True)
class Requirement:
    """A requirement and its negation in normal form, each implied by what it stands for."""

    holds: Normal
    fails: Normal


@dataclass(frozen=True, slots=True, eq=False)
class Scenario:
    """A checked scenario document.

    Attributes:
        name: id of the scenario.
        version: of the document, from 1.
        text: the YAML document, to be published.
        state: unit of each state that the formulas name.
        time_zero: nanoseconds since the Unix epoch, or None: each vehicle has its own (``zero: on_start``).
        semantics: whether the formulas speak about the samples or about real time.
        speed: bound of the rate of change of states, unit per second; empty unless ``continuous``.
        predicates: all distinct ones of the regions, ``assume`` and ``monitor``, each with a name of its own; the
            literals of the normal forms are places in it.
        regions: what each region means.
        assume: the side information.
        side_information: its normal form.
        monitor: requirements by name, which never cut.
        requirements: their normal forms.
    """

    name: str
    version: int
    text: str
    state: Mapping[str, str]
    time_zero: int | None
    semantics: Literal["sampled", "continuous"]
    speed: Mapping[str, float]
    predicates: tuple[Predicate, ...]
    regions: Mapping[str, Normal]
    assume: Formula
    side_information: Normal
    monitor: Mapping[str, Formula]
    requirements: Mapping[str, Requirement]

    @classmethod
    def parse(cls, text: str, source: str = "scenario") -> Self:
        """Scenario of a YAML document; raise ``ScenarioError`` with ``source``, line, column and a caret."""
        document = read_yaml(text, source)
        fields = read_fields(document)
        read = ScenarioText.of(fields, document)
        forms, monitor = read.forms, read.monitor
        side_information = forms.of(read.assume.formula, read.assume.excerpt)
        requirements = {
            name: Requirement(
                forms.of(found.formula, found.excerpt), forms.of(found.formula, found.excerpt, holds=False)
            )
            for name, found in monitor.items()
        }
        scenario = cls(
            fields.scenario,
            fields.version,
            text,
            fields.state,
            fields.time.zero,
            fields.time.semantics,
            fields.time.speed,
            forms.predicates(),
            {name: forms.region(name) for name in fields.regions},
            read.assume.formula,
            side_information,
            {name: found.formula for name, found in monitor.items()},
            requirements,
        )
        _check_semantics(scenario, fields, document)
        return scenario

    @classmethod
    def load(cls, name_or_path: str | Path) -> Self:
        """Scenario that ships under this name, or of a file; raise ``ScenarioError`` if it cannot be read."""
        if isinstance(name_or_path, str) and name_or_path in shipped():
            text = _SHIPPED.joinpath(f"{name_or_path}.yaml").read_text(encoding="utf-8")
            return cls.parse(text, f"{name_or_path}.yaml")
        try:
            text = read_document(Path(name_or_path))
        except FileNotFoundError:
            stem = Path(name_or_path).name.removesuffix(".yaml")
            meant = get_close_matches(stem, shipped(), 1)
            rest = f"did you mean {meant[0]}?" if meant else f"expected a file or one of {', '.join(shipped())}"
            raise ScenarioError(f"no file and no shipped scenario {str(name_or_path)[:200]!r}: {rest}") from None
        except OSError as error:
            raise ScenarioError(f"{name_or_path!s:.200}: cannot be read: {error.strerror}") from None
        except ValueError as error:
            raise ScenarioError(f"{Path(name_or_path)!s:.200}: {error}") from None
        return cls.parse(text, str(name_or_path))

    @property
    def end_ns(self) -> int:
        """Nanoseconds after time zero from which on nothing is known any more."""
        return reach_ns(self.side_information)

    @property
    def used(self) -> tuple[int, ...]:
        """Numbers of the predicates that the side information or a requirement speaks about, in order."""
        formulas = [self.side_information]
        for requirement in self.requirements.values():
            formulas += [requirement.holds, requirement.fails]
        return tuple(sorted({number for formula in formulas for number in literals_in(formula)}))

    def state_indices(self, profile: VehicleProfile) -> dict[str, int]:
        """Index in the state of ``profile`` of each state of this scenario; ``maps_to`` before equal names.

        Raises ``ScenarioError`` if one has no counterpart or another unit there, or if a predicate that is used speaks
        about an angle other than in ``sin``, ``cos`` or ``tan`` of a whole multiple of it: a vehicle that has turned
        once is 2π away from where the predicate looks for it.
        """
        indices = {}
        angles = set()
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
            if spec.angle:
                angles.add(name)
            indices[name] = profile.state_names.index(target)
        for predicate in (self.predicates[number] for number in self.used):
            angle = misused_angle(predicate, angles)
            if angle is not None:
                raise ScenarioError(
                    f"scenario {self.name}: its state {angle!r} is an angle of class {profile.vehicle_class}, which "
                    f"{predicate.name!r} uses like a length: expected it in sin, cos or tan, a whole number of times, "
                    f"such as cos({angle} - 0.5) >= 0.9"
                )
        return indices


_SHIPPED: Final = resources.files("side_info").joinpath("scenarios")


def shipped() -> tuple[str, ...]:
    """Names of the scenarios that ship with the package."""
    return tuple(
        sorted(entry.name.removesuffix(".yaml") for entry in _SHIPPED.iterdir() if entry.name.endswith(".yaml"))
    )


def _check_semantics(scenario: Scenario, fields: ScenarioFields, document: YamlText) -> None:
    """Raise ``ScenarioError`` if the document does not say, or says in vain, what its semantics need."""
    for state in fields.time.speed:
        if state not in fields.state:
            raise document.error(
                ("time", "speed", state),
                f"{state!r} is not declared: expected a state of {', '.join(fields.state)}",
                key=True,
            )
    if scenario.semantics == "sampled":
        if fields.time.speed:
            raise document.error(("time", "speed"), "a speed is of use to semantics: continuous only", key=True)
        return
    used = [scenario.predicates[number] for number in scenario.used]
    for predicate in used:
        expression = predicate.expression if isinstance(predicate, NonlinearPredicate) else None
        if expression is not None and any(isinstance(node, Steps | Last) for node in nodes_of(expression)):
            raise document.error(
                ("time", "semantics"),
                f"{predicate.name!r} speaks about samples (k, last): expected semantics: sampled, or a formula of t",
            )
    missing = sorted({state for predicate in used for state in predicate.states} - fields.time.speed.keys())
    if missing:
        raise document.error(
            ("time", "semantics"),
            f"continuous needs to know how fast {', '.join(missing)} can change: "
            f"add speed: {{{', '.join(f'{state}: …' for state in missing)}}} (unit per second) to time",
        )
