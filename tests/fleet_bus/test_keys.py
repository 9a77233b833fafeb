"""Keys that cannot be said wrongly."""

import pytest
import zenoh
from hypothesis import given
from hypothesis import strategies as st

from fleet_bus import keys
from fleet_bus.errors import KeyIdError, UsageError

ids = st.from_regex(keys.ID_PATTERN, fullmatch=True)

BUILDERS = (keys.state, keys.truth, keys.profile, keys.alive, keys.document, keys.tube, keys.event)
BAD_IDS = ("", "-a", ".a", "_a", "a b", "a/b", "a\n", "a\0", "@adv", "*", "**", "$*", "a#b", "a?b", "é", "a" * 65)


@given(ids)
def test_every_key_is_one_that_zenoh_takes_and_its_wildcard_covers(vehicle: str) -> None:
    for key, expression in (
        (keys.state(vehicle), keys.ALL_STATES),
        (keys.truth(vehicle), keys.ALL_TRUTHS),
        (keys.profile(vehicle), keys.ALL_PROFILES),
        (keys.alive(vehicle), keys.ALL_ALIVE),
        (keys.document(vehicle), keys.ALL_DOCUMENTS),
        (keys.assignment("lot", vehicle), keys.ALL_ASSIGNMENTS),
        (keys.tube(vehicle), keys.ALL_TUBES),
        (keys.event(vehicle), keys.ALL_EVENTS),
        (keys.service_status("reach", vehicle), keys.ALL_STATUS),
    ):
        assert zenoh.KeyExpr(expression).includes(zenoh.KeyExpr(key)), key


@given(ids)
def test_the_vehicle_comes_back_from_its_keys(vehicle: str) -> None:
    found = [
        keys.state(vehicle),
        keys.profile(vehicle),
        keys.alive(vehicle),
        keys.tube(vehicle),
        keys.event(vehicle),
        keys.assignment("lot", vehicle),
    ]
    assert {keys.vehicle_of(key) for key in found} == {vehicle}


@pytest.mark.parametrize("bad", BAD_IDS)
def test_an_id_that_is_no_chunk_is_refused_with_its_value_and_what_to_write(bad: str) -> None:
    for build in BUILDERS:
        with pytest.raises(KeyIdError, match="give a letter or digit") as caught:
            build(bad)
        assert repr(bad)[:60] in str(caught.value)
    for build_two in (keys.service, keys.service_status, keys.assignment):
        with pytest.raises(KeyIdError):
            build_two(bad, "a")
        with pytest.raises(KeyIdError):
            build_two("a", bad)
    assert issubclass(KeyIdError, UsageError)


@pytest.mark.parametrize(
    "key", ["", "fleet", "fleet/a", "fleet//state", "fleet/a b/state", "spec/lot/document", "svc/reach/a", "a/b/c"]
)
def test_a_key_without_a_vehicle_says_so(key: str) -> None:
    with pytest.raises(KeyIdError, match="vehicle"):
        keys.vehicle_of(key)


@given(st.text(max_size=200))
def test_any_text_is_either_a_key_of_a_vehicle_or_refused(text: str) -> None:
    refused = ""
    try:
        assert keys.check_id(keys.vehicle_of(text))
    except KeyIdError as error:
        refused = str(error)
    assert len(refused) < 300
