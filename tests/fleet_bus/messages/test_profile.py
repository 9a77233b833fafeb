"""Profiles: what is refused says where, what came and what is expected."""

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgpack
import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from fleet_bus.errors import ProfileError, UsageError
from fleet_bus.messages import VehicleProfile, load_profile, parse_profile
from tests.fleet_bus.messages.examples import a_profile, profile_fields, refusal

Change = Callable[[dict[str, Any]], object]


def broken(change: Change) -> dict[str, Any]:
    fields = profile_fields()
    change(fields)
    return fields


def test_a_profile_survives_the_wire_in_the_order_of_its_names() -> None:
    profile = a_profile()
    found = VehicleProfile.decode(profile.encode(), "application/msgpack;fleet.profile.v1")
    assert found == profile
    assert found.state_names == ("x", "y", "yaw", "v")
    assert found.input_names == ("steering", "velocity")
    assert found.encode() == profile.encode()
    assert found.shape_key() == profile.shape_key()


def test_what_follows_from_a_profile() -> None:
    profile = a_profile()
    assert profile.sample_time_ns == 50_000_000
    assert profile.angles.tolist() == [False, False, True, False]
    assert profile.position == (0, 1)
    assert profile.heading == 2
    assert profile.regressors == ("v", "steering", "velocity", "steering[k-1]", "velocity[k-1]")
    assert profile.guaranteed
    assert profile.noise.process is not None
    assert np.array_equal(profile.noise.process.matrix(), np.diag([0.01, 0.01, 0.02, 0.05]))
    assert profile.noise.measurement is not None
    assert profile.noise.measurement.matrix().shape == (4, 2)
    world = parse_profile(broken(lambda f: f.update(frame="world", lipschitz=None)))
    assert world.regressors[:4] == ("x", "y", "yaw", "v")


@pytest.mark.parametrize("part", ["process", "measurement", "lipschitz"])
def test_one_bound_that_is_not_given_ends_the_guarantee(part: str) -> None:
    fields = profile_fields()
    holder = fields if part == "lipschitz" else fields["noise"]
    holder[part] = {**holder[part], "origin": "calibrated"}
    assert not parse_profile(fields).guaranteed
    del holder[part]
    assert not parse_profile(fields).guaranteed


def test_the_shortest_profile_takes_the_defaults() -> None:
    profile = parse_profile({"class": "point", "state": {"x": "m"}, "sample_time": 1})
    assert (profile.window, profile.horizon, profile.confidence, profile.position) == (1000, 10, 0.99, (0, 0))
    assert (profile.frame, profile.method, profile.cuts, profile.future_inputs) == (
        "world",
        "default",
        "zonotope",
        "rate",
    )
    assert not profile.guaranteed


#: (what is wrong, the place, the value that came, what is expected); each must be in the message.
REFUSED: list[tuple[Change, str, str, str]] = [
    (lambda f: f.pop("class"), "class", "", "required"),
    (lambda f: f.pop("state"), "state", "", "required"),
    (lambda f: f.pop("sample_time"), "sample_time", "", "required"),
    (lambda f: f.update(colour="red"), "colour", "red", "not permitted"),
    (lambda f: f.update({"class": "a b"}), "class", "a b", "pattern"),
    (lambda f: f.update(state={}), "state", "{}", "at least 1"),
    (lambda f: f.update(state=["x"]), "state", "['x']", "dictionary"),
    (lambda f: f["state"].update({"1x": "m"}), "state.1x", "1x", "pattern"),
    (lambda f: f["state"].update(x=3), "state.x", "3", "dictionary"),
    (lambda f: f["state"].update(x={"unit": "m", "angel": True}), "state.x.angel", "True", "not permitted"),
    (lambda f: f["state"].update(x={"unit": "m", "angle": "yes"}), "state.x.angle", "yes", "boolean"),
    (lambda f: f["state"].update(x="metres per second"), "state.x.unit", "metres", "at most 16"),
    (lambda f: f["inputs"]["steering"].update(limits=[1, -1]), "inputs.steering", "[1.0, -1.0]", "reversed"),
    (lambda f: f["inputs"]["steering"].update(limits=[1]), "inputs.steering.limits", "", "required"),
    (lambda f: f["inputs"]["steering"].update(limits=["a", 1]), "inputs.steering.limits.0", "'a'", "number"),
    (lambda f: f["inputs"]["steering"].update(rate=0), "inputs.steering.rate", "0", "1e-30 to 1e+30"),
    (lambda f: f.update(sample_time="soon"), "sample_time", "soon", "ms, s or min"),
    (lambda f: f.update(sample_time=-1), "sample_time", "-1", "0.0001 to 60 s"),
    (lambda f: f.update(sample_time=10**400), "sample_time", "1000", "finite"),
    (lambda f: f.update(sample_time="2 min"), "sample_time", "2 min", "60"),
    (lambda f: f.update(tolerance=1), "tolerance", "1", "below 1"),
    (lambda f: f.update(frame="car"), "frame", "car", "'world' or 'body'"),
    (lambda f: f.update(input_lags=33), "input_lags", "33", "32"),
    (lambda f: f.update(input_lags="4"), "input_lags", "'4'", "integer"),
    (lambda f: f.update(input_lags=1.5), "input_lags", "1.5", "integer"),
    (lambda f: f.update(window=7), "window", "7", "8"),
    (lambda f: f.update(confidence=0.5), "confidence", "0.5", "above 0.5"),
    (lambda f: f.update(confidence=float("nan")), "confidence", "nan", "finite"),
    (lambda f: f.update(horizon=0), "horizon", "0", "1"),
    (lambda f: f.update(method="magic"), "method", "magic", "'calibrated'"),
    (lambda f: f.update(cuts="sharp"), "cuts", "sharp", "'constrained'"),
    (lambda f: f.update(future_inputs="hope"), "future_inputs", "hope", "'limits'"),
    (lambda f: f["noise"].update(process={"box": [1, 1, 1]}), "noise.process", "3 rows", "4"),
    (lambda f: f["noise"].update(process={"box": [1, 1, 1, -1]}), "noise.process.box.3", "-1", "0 to 1e+30"),
    (lambda f: f["noise"].update(process={"box": [1], "generators": [[1]]}), "noise.process", "box", "either"),
    (lambda f: f["noise"].update(process={}), "noise.process", "", "either box"),
    (lambda f: f["noise"].update(process={"generators": [[1], [1, 2]]}), "noise.process", "[1, 2]", "one length"),
    (lambda f: f["noise"].update(process={"generators": [1, 2]}), "noise.process.generators.0", "1", "list"),
    (lambda f: f["noise"].update(process={"generators": []}), "noise.process", "0 rows", "4"),
    (lambda f: f["noise"].update(proces={"box": []}), "noise.proces", "box", "not permitted"),
    (lambda f: f["noise"]["process"].update(origin="guessed"), "noise.process.origin", "guessed", "'given'"),
    (lambda f: f.update(lipschitz={}), "lipschitz", "", "either matrix"),
    (lambda f: f["lipschitz"].pop("upper"), "lipschitz", "", "lower and upper"),
    (lambda f: f["lipschitz"].update(matrix=[[1.0] * 5] * 4), "lipschitz", "", "either matrix"),
    (lambda f: f["lipschitz"].update(of="residual"), "lipschitz", "", "for the residual give matrix"),
    (lambda f: f["lipschitz"].update(lower=[[1.0] * 5] * 3), "lipschitz.lower", "[5, 5, 5]", "(4, 5)"),
    (lambda f: f["lipschitz"].update(upper=[[1.0] * 4] * 4), "lipschitz.upper", "[4, 4, 4, 4]", "(4, 5)"),
    (lambda f: f.update(lipschitz={"matrix": [[1.0], [1.0, 2.0]]}), "lipschitz.matrix", "[1, 2]", "(4, 5)"),
    (lambda f: f["roles"].update(speed="speed"), "roles.speed", "'speed'", "'v'"),
    (lambda f: f["roles"].update(steering="v"), "roles.steering", "'v'", "'steering'"),
    (lambda f: f["roles"].update(position=["x", "z"]), "roles.position", "'z'", "'y'"),
    (lambda f: f["roles"].update(position=["x"]), "roles.position", "", "required"),
    (lambda f: f["roles"].update(colour="v"), "roles.colour", "v", "not permitted"),
    (lambda f: f["maps_to"].update(x1="z"), "maps_to.x1", "'z'", "'x'"),
    (lambda f: f["roles"].pop("heading"), "roles", "body", "roles.heading"),
    (lambda f: f["roles"].update(heading="v"), "roles.heading", "'v'", "angle: true"),
    (lambda f: f["inputs"]["steering"].pop("limits"), "inputs.steering.limits", "rate", "needs"),
    (lambda f: f["inputs"]["steering"].pop("rate"), "inputs.steering.rate", "rate", "or choose future_inputs: limits"),
]


@pytest.mark.parametrize("case", REFUSED, ids=[f"{i}-{place}" for i, (_, place, _, _) in enumerate(REFUSED)])
def test_every_refusal_names_source_place_value_and_what_is_expected(case: tuple[Change, str, str, str]) -> None:
    change, place, value, expected = case
    with pytest.raises(ProfileError) as caught:
        parse_profile(broken(change), "car.yaml")
    message = str(caught.value)
    assert message.startswith("car.yaml: ")
    assert place in message
    assert value in message
    assert expected in message
    assert "\n" not in message
    assert len(message) < 1000


@pytest.mark.parametrize("what", [None, [], "text", 3, [("class", "svea")]])
def test_what_is_no_map_is_refused_by_type(what: object) -> None:
    with pytest.raises(ProfileError, match=f"a map is expected, {type(what).__name__} came"):
        parse_profile(what)


TEXTS = {
    "empty": "",
    "no map": "- 1",
    "not YAML": "a: [1",
    "no such day": "class: 2026-13-45\n",
    "no such number": "sample_time: " + "1" * 5000,
    "too deep": "[" * 3000,
    "a tag": "class: !!python/object:os.system {}",
    "two documents": "a: 1\n---\nb: 1\n",
    "control characters": "class: \x00",
    "number keys": "1: 2\n",
    "a key that is a list": "? [a]\n: b\n",
}


@pytest.mark.parametrize("what", TEXTS)
@pytest.mark.slow
def test_a_file_that_is_no_profile_is_refused_by_name(what: str, tmp_path: Path) -> None:
    path = tmp_path / "car.yaml"
    path.write_text(TEXTS[what], encoding="utf-8")
    with pytest.raises(ProfileError, match=r"car\.yaml"):
        load_profile(path)


def test_a_file_that_cannot_be_read_is_refused_by_name(tmp_path: Path) -> None:
    for path in (tmp_path / "none.yaml", tmp_path):
        with pytest.raises(ProfileError, match="cannot be read"):
            load_profile(path)
    (tmp_path / "latin.yaml").write_bytes(b"class: \xe9")
    with pytest.raises(ProfileError, match="cannot be read"):
        load_profile(tmp_path / "latin.yaml")
    assert issubclass(ProfileError, UsageError)


def test_a_file_is_what_its_fields_are(tmp_path: Path) -> None:
    path = tmp_path / "car.yaml"
    path.write_text(yaml.safe_dump(profile_fields(), sort_keys=False), encoding="utf-8")
    assert load_profile(path) == a_profile()


values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=8),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=4), inner, max_size=4),
    max_leaves=8,
)


@given(st.sampled_from(sorted(profile_fields())), values)
def test_any_value_of_a_field_is_accepted_or_refused(name: str, value: object) -> None:
    try:
        profile = parse_profile({**profile_fields(), name: value})
    except ProfileError:
        return
    assert VehicleProfile.decode(profile.encode()) == profile


def test_a_profile_on_the_wire_is_refused_by_reason() -> None:
    numbers = {"sample_time", "tolerance", "input_lags", "window", "confidence", "horizon", "inputs.steering.rate"}
    for change, place, value, _ in REFUSED:
        fields = broken(change)
        if value and place in numbers | {"noise.process.box.3"} and re.fullmatch(r"-?[\d.]+( min)?", value):
            reason = "fields" if value == "1.5" else "range"
        else:
            reason = "not_finite" if value == "nan" else "fields"
        if fields.get("sample_time") != 10**400:
            assert refusal(VehicleProfile.decode, msgpack.packb(fields)) == reason, (place, value)
