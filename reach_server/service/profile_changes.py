"""What is different between two profiles, in words, bounds first."""

from typing import Any, Final

from fleet_bus.messages import VehicleProfile

#: What guarantees rest on is named before anything else.
_FIRST: Final = ("noise", "lipschitz", "state", "inputs", "future_inputs", "method", "confidence")
_MOST: Final = 12


def profile_changes(before: VehicleProfile, after: VehicleProfile) -> str:
    """The fields that differ, each with what it was and what it is; the first 12, bounds before all others."""
    old, new = (_leaves(profile.model_dump(mode="json", by_alias=True)) for profile in (before, after))
    changed = [path for path in {**old, **new} if old.get(path) != new.get(path)]
    changed.sort(key=lambda path: _FIRST.index(head) if (head := path.partition(".")[0]) in _FIRST else len(_FIRST))
    told = [f"{path}: {old.get(path)!s:.60} → {new.get(path)!s:.60}" for path in changed[:_MOST]]
    more = len(changed) - len(told)
    return "; ".join(told) + (f"; and {more} more" if more > 0 else "")


def _leaves(value: Any, path: str = "") -> dict[str, Any]:
    if not isinstance(value, dict) or not value:
        return {path: value}
    found: dict[str, Any] = {}
    for key, part in value.items():
        found |= _leaves(part, f"{path}.{key}" if path else str(key))
    return found
