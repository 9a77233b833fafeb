"""Profiles by name or path."""

from importlib import resources
from pathlib import Path
from typing import Any

import yaml

from fleet_bus.errors import ProfileError, in_words
from fleet_bus.messages import VehicleProfile, load_profile
from vehicle_agent import svea

_SHIPPED = Path(str(resources.files("fleet_lab"))) / "profiles"


def shipped() -> tuple[str, ...]:
    """Names of the profiles that come with the project."""
    return ("svea", *sorted(path.stem for path in _SHIPPED.glob("*.yaml")))


def find_profile(name_or_path: str) -> VehicleProfile:
    """The shipped profile of this name, else that of the file; raise ``ProfileError`` listing the names."""
    return svea.profile() if name_or_path == "svea" else load_profile(_file(name_or_path))


def profile_fields(name_or_path: str) -> dict[str, Any]:
    """The fields of a profile that may still be incomplete, unchecked; raise ``ProfileError`` if it cannot be read."""
    if name_or_path == "svea":
        return svea.profile().model_dump(mode="json", by_alias=True, exclude_none=True)
    path = _file(name_or_path)
    try:
        fields = yaml.safe_load(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError) as error:
        raise ProfileError(f"{path}: cannot be read: {in_words(error)}") from None
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        raise ProfileError(f"{path}: not YAML: {error}") from None
    if not isinstance(fields, dict):
        raise ProfileError(f"{path}: a map is expected, {type(fields).__name__} came")
    return {str(name): value for name, value in fields.items()}


def _file(name_or_path: str) -> Path:
    if (path := _SHIPPED / f"{name_or_path}.yaml").is_file() and "/" not in name_or_path:
        return path
    path = Path(name_or_path)
    if not path.exists():
        raise ProfileError(f"profile {name_or_path!r} is neither a file nor one of {', '.join(shipped())}")
    return path
