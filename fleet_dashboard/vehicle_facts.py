"""What is known of one vehicle, as rows of text for its page."""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from fleet_bus import keys
from fleet_bus.errors import MessageError
from fleet_bus.messages import ReachTube, StateFlag, StateSample, VehicleProfile
from fleet_bus.pubsub import Received
from fleet_dashboard.gateway import Gateway

#: Name, value and what else is to be said.
Row = tuple[str, str, str]


def number(value: float) -> str:
    """Four digits."""
    return f"{value:.4g}" if math.isfinite(value) else "not known"


def state_of(gateway: Gateway, vehicle: str) -> StateSample | None:
    """The newest sample of a vehicle, None if none has come."""
    message = gateway.newest_state.get(keys.state(vehicle))
    return None if message is None else StateSample.decode(message.payload, message.encoding)


def tube_of(gateway: Gateway, vehicle: str) -> tuple[ReachTube | None, str]:
    """The newest tube of a vehicle; or none, and what is wrong with the one that is drawn (empty: none has come)."""
    message: Received | None = gateway.newest_tube.get(vehicle)
    if message is None:
        return None, ""
    try:
        return ReachTube.decode(message.payload, message.encoding), ""
    except MessageError as error:
        return None, f"{error.reason}: {error.detail}"


def state_rows(sample: StateSample, profile: VehicleProfile | None) -> list[Row]:
    """States with their units; without a profile they have neither."""
    names = None if profile is None or len(profile.state) != len(sample.x) else profile.state_names
    rows = []
    for i, value in enumerate(sample.x.tolist()):
        unit = "" if names is None or profile is None else profile.state[names[i]].unit
        bound = "" if sample.bound is None else f"± {number(float(sample.bound[i]))}"
        rows.append((f"state {i + 1}" if names is None else names[i], f"{number(value)} {unit}", bound))
    return rows


def input_rows(sample: StateSample, profile: VehicleProfile | None) -> list[Row]:
    """Inputs in force."""
    if sample.flags & StateFlag.INPUT_MISSING:
        return [("inputs", "not known", "the sample says so")]
    names = None if profile is None or len(profile.inputs) != len(sample.u) else profile.input_names
    rows = []
    for i, value in enumerate(sample.u.tolist()):
        unit = "" if names is None or profile is None else profile.inputs[names[i]].unit
        rows.append((f"input {i + 1}" if names is None else names[i], f"{number(value)} {unit}", ""))
    if sample.plan is not None:
        rows.append(("plan", f"{len(sample.plan)} inputs ahead", ""))
    return rows


def tube_rows(tube: ReachTube) -> list[Row]:
    """What the newest tube claims, and what it rests on."""
    ahead = (int(tube.times[-1]) - tube.t) / 1e9
    area, free = float(tube.area[-1]), float(tube.area_free[-1])
    cut = f"cut away {100 * (1 - area / free):.0f} %" if free > 0 else ""
    rows = [
        ("label", str(tube.label), f"method {tube.method}"),
        ("horizon", f"{len(tube.times)} steps, {ahead:.3g} s", ""),
        ("area of the first step", f"{number(float(tube.area[0]))} m²", ""),
        ("area of the last step", f"{number(area)} m²", f"without side information {number(free)} m² {cut}".strip()),
        ("server", tube.server, f"computed in {1e3 * tube.compute_seconds:.3g} ms with its batch"),
    ]
    rows += [("note", note, "") for note in tube.notes]
    rows += [(f"cut by {cut.predicate}", f"steps {cut.first} to {cut.last}", cut.scenario) for cut in tube.cuts]
    rows += [(f"verdict {name}", verdict, "") for name, verdict in tube.verdicts.items()]
    return rows


def audit_rows(tube: ReachTube, profile: VehicleProfile | None) -> list[Row]:
    """The record of one-step predictions."""
    audit = tube.audit
    rate = f"{100 * audit.inside / audit.checked:.2f} %" if audit.checked else ""
    recent = f"{100 * audit.recent_inside / audit.recent:.2f} %" if audit.recent else ""
    missed = audit.recent - audit.recent_inside
    nominal = "" if profile is None else "all" if profile.guaranteed else f"{100 * profile.confidence:g} %"
    return [
        ("checked", str(audit.checked), ""),
        ("inside", str(audit.inside), rate),
        ("of the newest", f"{audit.recent_inside} of {audit.recent}", recent),
        ("asked for", nominal or "no profile has come", ""),
        ("missed of the newest", str(missed), f"up to {audit.band} are explained by the confidence"),
        ("last miss, by", number(audit.last_miss), "largest component"),
    ]


def profile_rows(profile: VehicleProfile) -> list[Row]:
    """Every bound of a profile with where it is from: ``given`` by who wrote it, ``calibrated`` from data, or not
    stated."""
    rows: list[Row] = [
        ("class", profile.vehicle_class, ""),
        ("sample time", f"{profile.sample_time:g} s", f"tolerance {profile.tolerance:g}"),
        ("frame", profile.frame, ""),
        ("method", profile.method, f"cuts: {profile.cuts}, horizon {profile.horizon}, window {profile.window}"),
        ("confidence", f"{100 * profile.confidence:g} %", f"of each {profile.margin}"),
        ("later inputs", profile.future_inputs, f"{profile.input_lags} lagged inputs"),
    ]
    for kind, specs in (("state", profile.state), ("input", profile.inputs)):
        for name, spec in specs.items():
            parts = []
            if spec.limits is not None:
                parts.append(f"{spec.limits[0]:g} to {spec.limits[1]:g} {spec.unit}")
            if spec.rate is not None:
                parts.append(f"rate {spec.rate:g} {spec.unit}/s")
            rows.append((f"{kind} {name}", ", ".join(parts) or "no limits", "stated" if parts else "not stated"))
    for what, noise in (("process", profile.noise.process), ("measurement", profile.noise.measurement)):
        if noise is None:
            rows.append((f"{what} noise", "no bound", "not stated"))
        else:
            widths = np.abs(noise.matrix()).sum(axis=1)
            rows.append((f"{what} noise", "± " + _listed(widths, profile.state_names), noise.origin))
    slopes = profile.lipschitz
    if slopes is None:
        rows.append(("slopes", "no bound", "not stated"))
    else:
        given = slopes.matrix if slopes.matrix is not None else slopes.upper
        largest = np.abs(np.array(given)).max(axis=1)
        rows.append((f"slopes of the {slopes.of}", "up to " + _listed(largest, profile.state_names), slopes.origin))
    return rows


def _listed(values: NDArray[np.float64], names: Sequence[str]) -> str:
    return ", ".join(f"{name} {value:.3g}" for name, value in zip(names, values.tolist(), strict=True))
