"""The formulas of a scenario document, read where they stand."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Self

from side_info.documents.document import RegionFields, ScenarioFields
from side_info.documents.source_location import Excerpt
from side_info.documents.yaml_text import Path, YamlText
from side_info.stl.ast import And, Comparison, Formula, Temporal, formulas_in, parse_excerpt
from side_info.stl.declarations import RESERVED, Declarations
from side_info.stl.expression import Call, Expression, Name, Negation, Number, Sum
from side_info.stl.normal_form import NormalForms


@dataclass(frozen=True, slots=True)
class Found:
    """A formula, and its text where it stands."""

    formula: Formula
    excerpt: Excerpt


@dataclass(frozen=True, slots=True)
class ScenarioText:
    """What the formulas of a document say; ``regions`` has those that are texts, ``forms`` all of them."""

    regions: Mapping[str, Found]
    assume: Found
    monitor: Mapping[str, Found]
    forms: NormalForms

    @classmethod
    def of(cls, fields: ScenarioFields, document: YamlText) -> Self:
        """Read the formulas; raise ``ScenarioError`` at what is none, and at names with two meanings."""
        _check_names(fields, document)
        forms = NormalForms()
        regions = _regions(fields, document, forms)
        declared = Declarations(tuple(fields.state), tuple(fields.regions), fields.parameters)
        return cls(
            regions,
            _read(("assume",), document, declared),
            {name: _read(("monitor", name), document, declared) for name in fields.monitor},
            forms,
        )


def _read(path: Path, document: YamlText, declared: Declarations) -> Found:
    excerpt = document.excerpt(path)
    return Found(parse_excerpt(excerpt, declared), excerpt)


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


def _regions(fields: ScenarioFields, document: YamlText, forms: NormalForms) -> dict[str, Found]:
    """The regions that are texts, each of which may name the regions above it; ``forms`` gets all of them."""
    texts: dict[str, Found] = {}
    above: tuple[str, ...] = ()
    for name, region in fields.regions.items():
        path: Path = ("regions", name)
        if region.text is None:
            formula = _shape(path, region, fields, document)
            at = document.keys[path].start_mark.index
            excerpt = Excerpt("", document.source, document.text, (at,))
            forms.add_region(name, formula, excerpt, tuple(region.box or ()))
        else:
            declared = Declarations(tuple(fields.state), above, fields.parameters)
            found = _read(
                path if isinstance(document.fields["regions"][name], str) else (*path, "text"), document, declared
            )
            texts[name] = found
            for part in formulas_in(found.formula):
                if isinstance(part, Temporal):
                    word = type(part).__name__.lower()
                    raise found.excerpt.error(part.at, f"'{word}' has no place in a region: it speaks about one time")
            forms.add_region(name, found.formula, found.excerpt)
        above += (name,)
    return texts


def _shape(path: Path, region: RegionFields, fields: ScenarioFields, document: YamlText) -> Formula:
    """The formula that a box or disc stands for."""
    axes: Mapping[str, object] = region.box or {}
    if region.disc is not None:
        axes = region.disc.center
    for state in axes:
        if state not in fields.state:
            raise document.error(
                (*path, "box", state) if region.disc is None else (*path, "disc", "center", state),
                f"{state!r} is not declared: expected a state of {', '.join(fields.state)}",
                key=True,
            )
    if region.disc is not None:
        shifted = (Sum((Name(state), _number(-at))) for state, at in region.disc.center.items())
        return Comparison((Call("norm", tuple(shifted)), Number(region.disc.radius)), ("<=",))
    box = region.box or {}
    for state, (lower, upper) in box.items():
        if lower > upper:
            raise document.error((*path, "box", state), f"the bounds are reversed: {lower:g} > {upper:g}")
    sides = tuple(
        Comparison((_number(lower), Name(state), _number(upper)), ("<=", "<=")) for state, (lower, upper) in box.items()
    )
    return sides[0] if len(sides) == 1 else And(sides)


def _number(value: float) -> Expression:
    return Negation(Number(-value)) if value < 0 else Number(value)
