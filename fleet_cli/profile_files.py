"""Profiles by name or path."""

from importlib import resources
from pathlib import Path

from fleet_bus.errors import ProfileError
from fleet_bus.messages import VehicleProfile, load_profile
from vehicle_agent import svea

_SHIPPED = Path(str(resources.files("fleet_cli"))) / "profiles"


def shipped() -> tuple[str, ...]:
    """Names of the profiles that come with the project."""
    return ("svea", *sorted(path.stem for path in _SHIPPED.glob("*.yaml")))


def find_profile(name_or_path: str) -> VehicleProfile:
    """The shipped profile of this name, else that of the file; raise ``ProfileError`` listing the names."""
    if name_or_path == "svea":
        return svea.profile()
    if (path := _SHIPPED / f"{name_or_path}.yaml").is_file() and "/" not in name_or_path:
        return load_profile(path)
    path = Path(name_or_path)
    if not path.exists():
        raise ProfileError(f"profile {name_or_path!r} is neither a file nor one of {', '.join(shipped())}")
    return load_profile(path)
