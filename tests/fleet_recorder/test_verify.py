"""A recording gives the same tubes again, or the first thing that is not as it was is found."""

import random
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import msgpack
import numpy as np
import pytest

from fleet_bus import keys
from fleet_bus.messages import JournalRound, ReachTube, StateSample
from fleet_bus.pubsub import Received
from fleet_recorder.verify import verify
from fleet_recorder.verify_report import Finding, Report
from reach_server.engine.engine import Engine, PlannedInputs
from reach_server.engine.results import Tubes
from reach_server.numeric.types import IndexArray
from reach_server.service import registry
from tests.fleet_recorder.drive import BEFORE, PROFILES, SECOND, World, a_drive, region

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def recording() -> list[Received]:
    """A drive with two scenarios, a changed profile, a changed scenario and a restart of the server."""
    return a_drive().messages


def the_finding(report: Report) -> Finding:
    assert not report.equal
    assert len(report.all_findings) == 1
    return report.all_findings[0]


def rounds(messages: list[Received]) -> list[tuple[int, JournalRound]]:
    """The journal, each message with its place in the recording."""
    return [(k, JournalRound.decode(m.payload)) for k, m in enumerate(messages) if m.key.endswith("/journal")]


def changed(messages: list[Received], place: int, change: Callable[[bytes], bytes]) -> list[Received]:
    message = messages[place]
    return [*messages[:place], replace(message, payload=change(message.payload)), *messages[place + 1 :]]


def flipped(payload: bytes, at: int = -3) -> bytes:
    """A payload with one bit that is another one."""
    found = bytearray(payload)
    found[at] ^= 1
    return bytes(found)


def sample_after(messages: list[Received], place: int, vehicle: str) -> tuple[int, StateSample]:
    """The first sample of a vehicle that came after a place of the recording."""
    for k in range(place, len(messages)):
        if messages[k].key == keys.state(vehicle):
            return k, StateSample.decode(messages[k].payload)
    raise AssertionError(f"no sample of {vehicle}")


def test_a_recording_of_two_starts_gives_the_same_tubes_again(recording: list[Received]) -> None:
    report = verify(recording)
    assert report.equal, "\n".join(report.lines())
    assert [stretch.begins for stretch in report.stretches] == ["the checkpoint after round 1"] * 2
    put = [m for m in recording if m.key.endswith("/tube")]
    assert report.recorded == report.total("tubes") > 4 * SECOND
    # Those of the rounds in which the recorder was only just seen are recorded, too.
    assert len(put) - report.recorded <= 6
    assert report.total("samples") > 8 * SECOND
    assert report.total("events") >= 1
    assert report.unclaimed == 0
    assert report.json()["equal"] is True


def test_the_order_in_which_the_recorder_got_the_messages_does_not_matter(recording: list[Received]) -> None:
    other = list(recording)
    random.Random(1).shuffle(other)
    report = verify(iter(other))
    assert report.equal
    assert report.total("tubes") == verify(recording).total("tubes")


def test_a_bit_that_is_flipped_in_a_sample_is_found_at_that_sample(recording: list[Received]) -> None:
    tenth = rounds(recording)[10][0]
    place, sample = sample_after(recording, tenth, "b")
    report = verify(changed(recording, place, flipped))
    found = the_finding(report)
    assert (found.kind, found.vehicle, found.epoch, found.seq) == ("altered", "b", sample.epoch, sample.seq)
    assert found.key == "fleet/b/state"
    assert f"a sample (epoch {sample.epoch}, seq {sample.seq}) of another content" in found.what
    # What came before is claimed still, and so is the second start.
    assert [stretch.finding is None for stretch in report.stretches] == [False, True]
    assert report.stretches[0].last == found.round - 1
    assert 0 < report.stretches[0].tubes < report.stretches[1].tubes
    assert any(f"{found.vehicle} (epoch {found.epoch}, seq {found.seq})" in line for line in report.lines())


def test_a_sample_that_cannot_be_read_any_more_is_found_as_well(recording: list[Received]) -> None:
    place, sample = sample_after(recording, rounds(recording)[10][0], "a")
    found = the_finding(verify(changed(recording, place, lambda payload: flipped(payload, 0))))
    assert (found.kind, found.vehicle, found.key) == ("altered", "a", "fleet/a/state")
    # Its window has just begun anew: the first tube that rests on the sample comes later.
    assert found.seq > sample.seq
    assert "cannot be read" in found.what


def test_a_message_that_is_missing_is_named_and_nothing_is_claimed_from_there(recording: list[Received]) -> None:
    place, sample = sample_after(recording, rounds(recording)[10][0], "c")
    report = verify(recording[:place] + recording[place + 1 :])
    found = the_finding(report)
    assert (found.kind, found.key, found.vehicle) == ("missing", "fleet/c/state", "c")
    assert found.seq == sample.seq
    assert report.unclaimed > 10
    profiles = [m for m in recording if m.key != "fleet/c/profile"]
    assert {f.key for f in verify(profiles).all_findings} == {"fleet/c/profile"}


def test_a_journal_with_a_gap_is_no_proof_beyond_it(recording: list[Received]) -> None:
    place, lost = rounds(recording)[12]
    report = verify(recording[:place] + recording[place + 1 :])
    found = the_finding(report)
    assert (found.kind, found.round) == ("gap", lost.number)
    assert report.stretches[0].last == lost.number - 1


def test_a_journal_that_was_altered_breaks_its_chain(recording: list[Received]) -> None:
    place, written = rounds(recording)[12]
    forged = replace(written, totals=(1, 1, 1)).encode()
    found = the_finding(verify(changed(recording, place, lambda _: forged)))
    assert (found.kind, found.round) == ("chain", written.number)


def test_a_journal_that_was_rewritten_does_not_agree_with_the_status(recording: list[Received]) -> None:
    """Who makes a chain anew has to alter every status, too."""
    told = [(k, msgpack.unpackb(m.payload)) for k, m in enumerate(recording) if m.key.endswith("/status")]
    status, fields = next((k, fields) for k, fields in told if int(fields["chain"]["round"]) > 5)
    fields["chain"]["value"] = "0" * 32
    found = verify(changed(recording, status, lambda _: msgpack.packb(fields))).all_findings
    assert [f.kind for f in found] == ["chain"]


def test_a_tube_that_was_altered_in_the_recording_is_found(recording: list[Received]) -> None:
    place = [k for k, m in enumerate(recording) if m.key == "reach/a/tube"][20]
    found = the_finding(verify(changed(recording, place, lambda payload: flipped(payload, -40))))
    assert (found.kind, found.vehicle) == ("recorded", "a")


def test_a_checkpoint_that_was_altered_is_not_begun_from(recording: list[Received]) -> None:
    place = next(k for k, m in enumerate(recording) if m.key.endswith("/checkpoint"))
    report = verify(changed(recording, place, lambda payload: flipped(payload, -2000)))
    assert the_finding(report).kind == "checkpoint"
    assert len(report.stretches) == 1


def test_a_recording_without_a_journal_proves_nothing(recording: list[Received]) -> None:
    report = verify(m for m in recording if not m.key.endswith(("/journal", "/checkpoint")))
    assert not report.equal
    assert not report.all_findings
    assert "no journal" in "\n".join(report.lines())
    assert not verify([]).equal


def test_what_is_no_message_of_the_fleet_is_told_and_passed_over(recording: list[Received]) -> None:
    odd = [
        Received(key, b"\xc1", "text/plain", None) for key in ("svc/reach/one/journal", "reach/a/tube", "x", "fleet/a")
    ]
    report = verify([*odd, *recording])
    assert report.equal
    assert sum("not read" in note for note in report.notes) == 2


def test_a_recording_that_begins_in_the_middle_begins_with_a_checkpoint() -> None:
    world, began = World(), 0
    world.add("a", PROFILES["set_membership"])
    world.add("b", PROFILES["hull"], seed=1)
    world.before()
    for name in ("near", "far"):
        world.side_info.publish(region(name, 2.0))
        world.side_info.assign(name, "a", BEFORE)

    def come() -> None:
        nonlocal began
        began = len(world.messages)
        world.record()

    world.serve(2.0, {SECOND: come})
    report = verify(world.messages[began:])
    assert report.equal, "\n".join(report.lines())
    (stretch,) = report.stretches
    assert stretch.first > SECOND / 2
    assert stretch.tubes >= 2 * (SECOND - 3)


def test_a_recorder_that_begins_another_file_misses_no_round() -> None:
    world = World()
    world.add("a", PROFILES["set_membership"])
    world.before()
    token, cut = world.record(), 0

    def begin() -> None:
        nonlocal cut
        cut = len(world.messages)
        token.close()
        world.record("two")

    world.serve(2.0, {SECOND: begin})
    assert verify(world.messages).equal
    second = verify(world.messages[cut:])
    assert second.equal
    assert len(verify(world.messages).stretches) == 1


def test_who_leaves_is_let_go_and_another_gets_its_place(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(registry, "LEAST_SILENT_KEPT", 0)
    world = World()
    for vehicle in ("a", "b"):
        world.add(vehicle, PROFILES["set_membership"])
    world.before()
    world.record()

    def leave() -> None:
        world.cars.pop().token.close()

    def come() -> None:
        world.add("c", PROFILES["set_membership"]).drive(BEFORE)

    world.serve(6.0, {5: leave, 5 * SECOND: come})
    assert [call.subject for _, r in rounds(world.messages) for call in r.calls if call.kind == "gone"] == ["b"]
    report = verify(world.messages)
    assert report.equal, "\n".join(report.lines())
    assert {ReachTube.decode(m.payload).vehicle for m in world.messages[-60:] if m.key.endswith("/tube")} == {"a", "c"}


def test_an_error_of_the_fleet_comes_again_or_is_a_finding(monkeypatch: pytest.MonkeyPatch) -> None:
    world = World()
    world.add("a", PROFILES["set_membership"])
    world.before()
    world.record()
    original = Engine.predict

    def predict(self: Engine, slots: IndexArray, known: PlannedInputs | None = None, *more: Any) -> Tubes:
        if int(self.window.newest(slots)[1].max()) == BEFORE + 12:
            raise ValueError("a sample that nobody has thought of")
        return original(self, slots, known, *more)

    monkeypatch.setattr(Engine, "predict", predict)
    world.serve(1.0)
    assert {r.failed for _, r in rounds(world.messages)} == {"", "fleet: ValueError"}
    assert verify(world.messages).equal
    monkeypatch.undo()
    found = the_finding(verify(world.messages))
    assert found.kind == "failure"
    assert "fleet: ValueError at the server, with no error here" in found.what


def test_a_fleet_that_computes_otherwise_is_found_at_its_first_tube(monkeypatch: pytest.MonkeyPatch) -> None:
    world = World()
    world.add("a", PROFILES["set_membership"])
    world.before()
    world.record()
    world.serve(1.0)
    original = Engine.predict

    def predict(self: Engine, slots: IndexArray, known: PlannedInputs | None = None, *more: Any) -> Tubes:
        made = original(self, slots, known, *more)
        if int(self.window.newest(slots)[1].max()) < BEFORE + 12:
            return made
        return replace(made, area=np.nextafter(made.area, np.inf))

    monkeypatch.setattr(Engine, "predict", predict)
    found = the_finding(verify(world.messages))
    assert (found.kind, found.vehicle, found.epoch, found.seq) == ("tube", "a", 1, BEFORE + 12)


def test_a_round_that_an_error_ended_is_computed_anew_up_to_it() -> None:
    world = World()
    world.add("a", PROFILES["set_membership"])
    world.add("b", PROFILES["hull"], seed=1)
    world.before()
    world.record()
    done: list[int] = []

    def breaks() -> None:
        if world.network.puts[-1].key == "reach/a/tube" and len(done) < 3:
            done.append(len(world.network.puts))
            raise RuntimeError("the network is gone")

    world.network.on_put = breaks
    world.serve(1.0)
    assert len(done) == 3
    assert {r.failed for _, r in rounds(world.messages)} == {"", "RuntimeError"}
    assert verify(world.messages).equal
