"""``Route``: where a simulated vehicle drives, and the timed zones that its true position must stay in."""

from importlib import resources
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Annotated, Final

import numpy as np
import yaml
from numpy.typing import NDArray
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError, model_validator

from fleet_bus.errors import UsageError, in_words
from fleet_bus.messages.documents import explain
from fleet_bus.units import seconds

Seconds = Annotated[float, BeforeValidator(seconds)]
Interval = tuple[float, float]

# Sample times are multiples of the sample time up to rounding; a window's ends belong to it.
_SAME_INSTANT: Final = 1e-9


class _Part(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class Box(_Part):
    """Intervals of x and y in m; one that is not given is unbounded."""

    x: Interval | None = None
    y: Interval | None = None


class Disc(_Part):
    """All points at most ``radius`` m from ``center`` (x, y) m."""

    center: tuple[float, float]
    radius: Annotated[float, Field(gt=0)]


class Ring(_Part):
    """All points whose distance (m) from ``center`` (x, y) m lies in the interval ``radius``."""

    center: tuple[float, float]
    radius: Interval


class Zone(_Part):
    """A box, disc or ring that the position stays in for ``start`` ≤ t ≤ ``end`` (s, both included)."""

    name: str
    start: Seconds
    end: Seconds
    box: Box | None = None
    disc: Disc | None = None
    ring: Ring | None = None

    @model_validator(mode="after")
    def _one_form(self) -> "Zone":
        if sum(form is not None for form in (self.box, self.disc, self.ring)) != 1:
            raise ValueError("give one of box, disc and ring")
        if self.end < self.start:
            raise ValueError(f"the window [{self.start}, {self.end}] s is reversed")
        return self

    def clearance(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Distance (...) in m of ``points`` (..., 2) from the border, negative outside; exact inside."""
        distance: NDArray[np.float64]
        if self.disc is not None:
            distance = self.disc.radius - np.hypot(*np.moveaxis(points - self.disc.center, -1, 0))
            return distance
        if self.ring is not None:
            away = np.hypot(*np.moveaxis(points - self.ring.center, -1, 0))
            distance = np.minimum(away - self.ring.radius[0], self.ring.radius[1] - away)
            return distance
        assert self.box is not None
        sides = [np.full(points.shape[:-1], np.inf)]
        for axis, interval in ((0, self.box.x), (1, self.box.y)):
            if interval is not None:
                sides += [points[..., axis] - interval[0], interval[1] - points[..., axis]]
        distance = np.min(sides, axis=0)
        return distance


class Start(_Part):
    """Region of the first pose: intervals of x m, y m and yaw rad; the vehicle stands."""

    x: Interval
    y: Interval
    yaw: Interval


class WayPoint(_Part):
    """A point (x, y) m to drive towards, the speed to pass it with (m/s) and maybe when (s since the start).

    ``jitter`` (m) is how far a vehicle's own point may lie from it in x and in y.
    """

    x: float
    y: float
    speed: Annotated[float, Field(gt=0)]
    at: Seconds | None = None
    jitter: tuple[float, float] = (0.0, 0.0)


class Route(_Part):
    """Way points and zones; each vehicle drives its own variation.

    ``margin`` (m) and ``slack`` (s) tighten the zones: a drive obeys the route if its position is ``margin``
    inside each zone, from ``slack`` before its window to ``slack`` after it. ``speed_jitter`` is the fraction
    by which the speeds of a vehicle vary; ``mirror`` the x (m) in which every other vehicle's way points are
    mirrored.
    """

    route: str
    duration: Annotated[Seconds, Field(gt=0)]
    start: Start
    way_points: Annotated[list[WayPoint], Field(min_length=2)]
    zones: list[Zone] = Field(default_factory=list)
    margin: Annotated[float, Field(ge=0)] = 0.03
    slack: Annotated[Seconds, Field(ge=0)] = 0.0
    speed_jitter: Annotated[float, Field(ge=0, lt=1)] = 0.0
    mirror: float | None = None

    @model_validator(mode="after")
    def _times_in_order(self) -> "Route":
        times = [point.at for point in self.way_points if point.at is not None]
        if any(b <= a for a, b in zip([0.0, *times], times, strict=False)):
            raise ValueError(f"the times of the way points {times} s must increase from above 0")
        return self

    def clearance(self, t: NDArray[np.float64], points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Least clearance (Z,) in m of each zone for positions ``points`` (K, 2) m at ``t`` (K,) s.

        It is inf for a zone whose window, widened by ``slack``, holds no sample.
        """
        least = np.full(len(self.zones), np.inf)
        for i, zone in enumerate(self.zones):
            reach = self.slack + _SAME_INSTANT
            active = (t >= zone.start - reach) & (t <= zone.end + reach)
            least[i] = zone.clearance(points[active]).min(initial=np.inf)
        return least

    def obeyed(self, t: NDArray[np.float64], points: NDArray[np.float64]) -> bool:
        """Whether the positions ``points`` (K, 2) m at ``t`` (K,) s stay in every zone, ``margin`` inside."""
        return bool((self.clearance(t, points) >= self.margin).all())


def route_names() -> tuple[str, ...]:
    """Names of the routes that ship with the package."""
    return tuple(sorted(entry.name.removesuffix(".yaml") for entry in _shipped().iterdir()))


def load_route(name: str | Path) -> Route:
    """Route of a YAML file (a ``Path``) or of a name in ``route_names``; raise ``UsageError`` if none."""
    if isinstance(name, str) and name not in route_names():
        raise UsageError(
            f"no route {name!r:.80}; there are {', '.join(route_names())}, or give the path of a YAML file"
        )
    file: Traversable = name if isinstance(name, Path) else _shipped() / f"{name}.yaml"
    try:
        return Route.model_validate(yaml.safe_load(file.read_text(encoding="utf-8")))
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise UsageError(f"route {name}: cannot be read: {in_words(error)}") from None
    except ValidationError as error:
        raise UsageError(f"route {name}: {explain(error)}") from None


def _shipped() -> Traversable:
    return resources.files("vehicle_agent") / "routes"
