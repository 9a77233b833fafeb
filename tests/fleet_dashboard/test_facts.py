"""What the page of a vehicle says: labels as the documentation has them, and the origin of every bound."""

import re
from pathlib import Path

import pytest

from fleet_bus.messages import Label, StateFlag, StateSample, parse_profile
from fleet_dashboard.meaning import MEANINGS
from fleet_dashboard.picture import STALE, Mark
from fleet_dashboard.recording import load
from fleet_dashboard.vehicle_facts import (
    audit_rows,
    input_rows,
    profile_rows,
    state_of,
    state_rows,
    tube_of,
    tube_rows,
)
from fleet_lab.profile_files import find_profile
from tests.fleet_dashboard.messages import PROFILE, SECOND, T0, of_profile, of_state, of_tube, tube
from tests.fleet_dashboard.test_gateway import fed

ROOT = Path(__file__).resolve().parents[2]


def test_labels_mean_what_the_documentation_says() -> None:
    text = (ROOT / "docs" / "concepts" / "guarantees.md").read_text(encoding="utf-8")
    rows = {}
    for line in text.splitlines():
        cells = [cell.strip() for cell in line.strip("|").split("|")]
        if len(cells) == 5 and cells[0].strip("`") in set(map(str, Label)):
            plain = [re.sub(r"\[([^]]*)\]\([^)]*\)", r"\1", cell).replace("`", "") for cell in cells]
            rows[plain[0]] = tuple(plain[1:])
    assert rows == {str(label): tuple(meaning) for label, meaning in MEANINGS.items()}


def test_the_browser_knows_the_marks() -> None:
    source = (ROOT / "fleet_dashboard" / "map" / "frame.js").read_text(encoding="utf-8")
    found = {
        name: sum(map(int, value.split("|"))) for name, value in re.findall(r"export const (\w+) = ([\d| ]+);", source)
    }
    assert found == {"STALE": int(STALE), "ASTRAY": int(Mark.LEFT | Mark.VIOLATES)}
    assert all(mark.words for mark in Mark)


def test_states_have_names_and_units_of_the_profile_or_none() -> None:
    gateway, _ = fed(of_profile("a"), of_state("a", [1.5, 2, 3, 0.5]))
    sample = state_of(gateway, "a")
    assert sample is not None
    assert state_rows(sample, PROFILE)[0] == ("v", "1.5 m/s", "")
    assert state_rows(sample, None)[0] == ("state 1", "1.5 ", "")
    assert input_rows(sample, PROFILE) == [("u", "0 1", "")]
    unknown = StateSample(epoch=1, seq=0, t=T0, flags=StateFlag.INPUT_MISSING, x=sample.x, u=sample.u)
    assert input_rows(unknown, PROFILE) == [("inputs", "not known", "the sample says so")]
    assert state_of(gateway, "b") is None


def test_every_bound_of_a_profile_says_where_it_is_from() -> None:
    rows = {name: (value, origin) for name, value, origin in profile_rows(find_profile("svea"))}
    assert rows["process noise"][1] == "given"
    assert rows["measurement noise"][1] == "given"
    assert rows["slopes of the dynamics"][1] == "given"
    assert rows["input steering"][1] == "stated"
    rows = {name: (value, origin) for name, value, origin in profile_rows(PROFILE)}
    assert rows["process noise"] == ("no bound", "not stated")
    assert rows["slopes"] == ("no bound", "not stated")
    assert rows["state x"] == ("no limits", "not stated")
    assert rows["input u"] == ("-1 to 1 1, rate 1 1/s", "stated")
    fitted = parse_profile(
        PROFILE.model_dump(by_alias=True, exclude_none=True) | {"noise": {"process": {"box": [1, 2, 3, 4]}}}
    )
    rows = {name: (value, origin) for name, value, origin in profile_rows(fitted)}
    assert rows["process noise"] == ("± v 1, x 2, y 3, yaw 4", "calibrated")


def test_a_tube_says_what_it_rests_on() -> None:
    gateway, _ = fed(of_tube(tube("a", verdicts={"lot.r": "satisfied"})))
    found, wrong = tube_of(gateway, "a")
    assert found is not None
    assert wrong == ""
    rows = tube_rows(found)
    assert ("verdict lot.r", "satisfied", "") in rows
    assert any("cut away 50 %" in rest for _, _, rest in rows)
    assert ("of the newest", "99 of 100", "99.00 %") in audit_rows(found, PROFILE)
    assert ("asked for", "90 %", "") in audit_rows(found, PROFILE)
    assert tube_of(gateway, "b") == (None, "")


@pytest.mark.slow
def test_a_recording_becomes_a_history() -> None:
    messages = [of_profile("a")]
    for k in range(100):
        t = T0 + k * SECOND // 20
        messages += [of_state("a", [0, k, 0, 0], seq=k, arrived=t), of_tube(tube("a", seq=k, at=(k, 0)), t)]
    # A gap of an hour.
    messages.append(of_state("a", [0, 500, 0, 0], seq=500, arrived=T0 + 3600 * SECOND))
    gateway = load(messages)
    span = gateway.history.span()
    assert span is not None
    assert T0 < span[0] <= T0 + SECOND // 10
    assert span[1] >= T0 + 3600 * SECOND
    then = gateway.history.at(T0 + 2 * SECOND)
    assert then is not None
    assert 36 <= then.position[0, 0] <= 40
    assert not then.stale().any()
    gap = gateway.history.at(T0 + 1800 * SECOND)
    assert gap is not None
    assert gap.position[0, 0] == 99
    assert Mark.SILENT in Mark(int(gap.marks[0]))
    assert gateway.picture.position[0, 0] == 500
