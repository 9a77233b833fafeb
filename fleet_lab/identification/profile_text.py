"""The profile as a YAML text that says where each value comes from."""

import textwrap
from collections.abc import Mapping, Sequence
from typing import Any, Final

import yaml

from fleet_bus.messages import VehicleProfile
from fleet_lab.identification.calibrate import Calibration, CalibrationError
from fleet_lab.identification.draft import Choice

#: Fields always written, whether or not they have the default value.
_WRITTEN: Final = (
    "class", "state", "inputs", "sample_time", "tolerance", "frame", "input_lags", "window", "reservoir", "nearest",
    "noise", "lipschitz", "future_inputs", "filtered", "confidence", "margin", "roles", "horizon", "method", "cuts",
    "maps_to",
)  # fmt: skip
_ALWAYS: Final = {
    "class", "state", "inputs", "sample_time", "tolerance", "frame", "input_lags", "window", "noise", "future_inputs",
    "confidence", "roles", "horizon", "method",
}  # fmt: skip


def as_yaml(calibration: Calibration, recordings: Sequence[str]) -> str:
    """A profile document that loads to ``calibration.profile``."""
    fields = calibration.profile.model_dump(mode="json", by_alias=True, exclude_none=True)
    standard = _defaults()
    written = {n: v for n, v in fields.items() if n in _ALWAYS or v != standard.get(n)}
    head = [
        f"Calibrated from {', '.join(recordings)}.",
        "What is marked origin: calibrated was fitted, no one vouches for it.",
    ]
    return _as_text(head, written, _comments(calibration.choices))


def draft_as_yaml(error: CalibrationError, recordings: Sequence[str]) -> str:
    """What is known of a profile where a calibration could not be made, and why it could not."""
    head = [
        f"Draft of a profile, from {', '.join(recordings)}: no calibration could be made.",
        *textwrap.wrap(str(error), 110, break_long_words=False),
        "What stands below counts as stated from then on: correct it, and leave out what is to be estimated anew.",
    ]
    return _as_text(head, error.fields, _comments(error.choices))


def _as_text(head: Sequence[str], fields: Mapping[str, Any], comments: Mapping[str, str]) -> str:
    lines = [f"# {line}" for line in head]
    for name in (*(n for n in _WRITTEN if n in fields), *(n for n in fields if n not in _WRITTEN)):
        lines += _field(name, fields[name], comments)
    return "\n".join(lines) + "\n"


def _defaults() -> dict[str, Any]:
    fields = VehicleProfile.model_fields
    return {name: f.default for name, f in fields.items()} | {"lipschitz": None, "maps_to": {}}


def _comments(choices: Sequence[Choice]) -> dict[str, str]:
    return {c.field: f"{c.origin}: {c.why}" for c in choices if c.origin != "given"}


def _field(name: str, value: Any, comments: Mapping[str, str]) -> list[str]:
    note = f"  # {comments[name]}" if name in comments else ""
    if name == "sample_time" and isinstance(value, float):
        return [f"sample_time: {1e3 * value:g} ms{note}"]
    if name in ("state", "inputs", "noise") and isinstance(value, Mapping):
        lines = [f"{name}:{note}"] if value else [f"{name}: {{}}{note}"]
        for key, part in value.items():
            own = comments.get(f"{name}.{key}") or comments.get(f"{name}.{key}.limits")
            lines.append(f"  {key}: {_flow(_short(part))}{f'  # {own}' if own else ''}")
        return lines
    if name == "lipschitz" and isinstance(value, Mapping):
        lines = [f"lipschitz:{note}"]
        for key, part in value.items():
            if isinstance(part, list):
                lines += [f"  {key}:", *(f"    - {_flow(row)}" for row in part)]
            else:
                lines.append(f"  {key}: {part}")
        return lines
    return [f"{name}: {_flow(value)}{note}"]


def _short(part: Any) -> Any:
    """A quantity without what says nothing; a mere unit as text."""
    if not isinstance(part, Mapping) or "unit" not in part:
        return part
    kept = {key: value for key, value in part.items() if not (key == "angle" and value is False)}
    return kept["unit"] if set(kept) == {"unit"} else kept


def _flow(value: Any) -> str:
    text = yaml.safe_dump(value, default_flow_style=True, width=10**9, sort_keys=False, allow_unicode=True)
    return text.removesuffix("...\n").strip()
