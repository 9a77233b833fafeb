"""Recordings published again: order, bytes, speed, and what is left out."""

import threading
from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import pytest

from fleet_bus import keys
from fleet_bus.errors import UsageError
from fleet_bus.messages import Assignment, Event, EventKind, ReachTube, ScenarioDocument, ServiceStatus, StateSample
from fleet_bus.messages import state as state_message
from fleet_bus.pubsub import Received
from fleet_recorder.layout import Recorded
from fleet_recorder.player import Player, Report
from fleet_recorder.shift import shifted
from tests.fleet_bus.messages import examples
from tests.fleet_recorder.made import T0, assignment, document, event, numbered, profile, recorded, state, status, token
from tests.memory_bus import Network

#: Messages of 3 s of a fleet, of which the first were carried over from hours before.
HOURS = 3600 * 10**9


def carried(received: Received, number: int) -> Recorded:
    return Recorded(replace(received, arrived_ns=T0 - HOURS), number, T0, carried=True)


INPUTS = [
    carried(profile(), 0),
    carried(document(1), 1),
    carried(assignment(T0 + 10**9), 2),
    carried(token("a", True, T0 - HOURS), 3),
    *(recorded(state(20 * n), 4 + n) for n in range(4)),
]
OUTPUTS = [
    recorded(event(EventKind.MISS, T0 + 10**9), 20),
    recorded(status(T0 + 10**9), 21),
    recorded(token("a", False, T0 + 2 * 10**9), 22),
]


def play(messages: Iterable[Recorded], **more: Any) -> tuple[Network, Report, list[tuple[str, float]]]:
    """The bus after playing, the report, and when (s) which key was put."""
    network = Network()
    times: list[tuple[str, float]] = []
    network.on_put = lambda: times.append((network.puts[-1].key, network.time.now))
    with Player(network.bus(), clock=network.time, **more) as player:
        report = player.play(messages, threading.Event())
    return network, report, times


def test_the_same_bytes_come_in_the_same_order() -> None:
    network, report, _ = play(INPUTS)
    wanted = [m.received for m in INPUTS if m.received.key != keys.alive("a")]
    assert [(m.key, m.payload, m.encoding) for m in network.puts] == [(m.key, m.payload, m.encoding) for m in wanted]
    assert report.published == {"profile": 1, "document": 1, "assignment": 1, "alive": 1, "state": 4}
    assert report.left_out == {}
    assert report.ended


@pytest.mark.parametrize(("speed", "seconds"), [(1.0, 3.0), (10.0, 0.3), (0.5, 6.0), (float("inf"), 0.0)])
def test_messages_come_as_far_apart_as_they_did(speed: float, seconds: float) -> None:
    """What was in force before the recording is there at once, however old it is."""
    _, report, times = play(INPUTS, speed=speed)
    assert [at for key, at in times if not key.endswith("state")] == [0.0] * 3
    states = [at for key, at in times if key.endswith("state")]
    assert states == pytest.approx([seconds * n / 3 for n in range(4)], abs=1e-5)
    assert report.late == pytest.approx(0.0, abs=1e-5)


def test_a_clock_that_was_set_back_makes_nobody_wait() -> None:
    messages = [recorded(state(0), 0), recorded(replace(state(20), arrived_ns=T0 - HOURS), 1), recorded(state(40), 2)]
    _, _, times = play(messages)
    assert [at for _, at in times] == pytest.approx([0.0, 0.0, 2.0], abs=1e-5)


def test_a_bus_that_is_slow_is_told() -> None:
    network = Network()

    def slow() -> None:
        network.time.now += 5

    network.on_put = slow
    with Player(network.bus(), clock=network.time) as player:
        report = player.play(INPUTS[4:], threading.Event())
    assert report.late == pytest.approx(15 - 3, abs=0.1)


def test_only_inputs_are_published_unless_everything_is_asked_for() -> None:
    messages = [*INPUTS, *OUTPUTS]
    network, report, _ = play(messages)
    assert report.left_out == {"no input of a server": 2}
    assert {m.key for m in network.puts} == {m.received.key for m in INPUTS} - {keys.alive("a")}
    network, report, _ = play(messages, everything=True)
    assert report.left_out == {}
    assert {m.key for m in network.puts} == {m.received.key for m in messages} - {keys.alive("a")}


def test_vehicles_are_alive_as_they_were() -> None:
    network = Network()
    seen: list[tuple[bool, int]] = []
    watcher = network.bus()
    watcher.watch_alive(keys.ALL_ALIVE, lambda key, alive: seen.append((alive, len(network.puts))))
    with Player(network.bus(), clock=network.time) as player:
        player.play([*INPUTS, OUTPUTS[2], recorded(token("b", True, T0), 30)], threading.Event())
        assert seen == [(True, 3), (False, 7), (True, 7)]
    # What is played is gone with the player.
    assert seen[-1] == (False, 7)
    assert network.tokens == []
    assert network.publishers == []


def test_latecomers_get_a_window_of_states_and_the_newest_document() -> None:
    network = Network()
    late: list[Received] = []
    many = [recorded(state(n), n) for n in range(1500)]
    with Player(network.bus(), clock=network.time, speed=float("inf")) as player:
        player.play([*INPUTS[:2], carried(document(2), 9), *many], threading.Event())
        network.bus().subscriber("**", late.append, history=10_000)
    states = [m.payload for m in late if m.key == keys.state("a")]
    assert states == [m.received.payload for m in many[-1200:]]
    assert [m.payload for m in late if m.key == keys.document("s")] == [document(2).payload]


@pytest.mark.parametrize(
    ("message", "why"),
    [
        (Received("fleet/a b/state", b"x", state(0).encoding, None), "its key is none of the fleet's"),
        (Received("fleet/a/state", b"", "zenoh/bytes", None), "its encoding is none of the fleet's"),
        (
            Received("fleet/a/state", b"x", "application/msgpack;" + "x" * 300, None),
            "its encoding is none of the fleet's",
        ),
    ],
)
def test_what_zenoh_may_stumble_over_is_left_out_and_counted(message: Received, why: str) -> None:
    network, report, _ = play([recorded(message, 0), recorded(state(0), 1)])
    assert report.left_out == {why: 1}
    assert [m.payload for m in network.puts] == [state(0).payload]


def test_it_ends_when_told_to_in_the_middle_of_a_wait() -> None:
    network, stop = Network(), threading.Event()
    network.time.on_wait = lambda now: stop.set() if now > 0.5 else None
    with Player(network.bus(), clock=network.time) as player:
        report = player.play(INPUTS, stop)
    assert report.published["state"] == 1
    assert not report.ended
    with Player(network.bus(), clock=network.time, speed=float("inf")) as player:
        assert player.play(INPUTS, stop) == Report({}, {}, 0.0, ended=False)


@pytest.mark.parametrize("speed", [0.0, -1.0, float("nan")])
def test_a_speed_that_is_none_is_refused(speed: float) -> None:
    with pytest.raises(UsageError, match="speed"):
        Player(Network().bus(), speed=speed)


def test_shifted_the_recording_begins_now_and_keeps_its_intervals() -> None:
    network, _, _ = play(INPUTS, shift=True)
    # The network's clock stands at T0 as well: play it a day later.
    network = Network()
    network.time.now = 86_400.0
    with Player(network.bus(), clock=network.time, shift=True) as player:
        player.play(INPUTS, threading.Event())
    by = 86_400 * 10**9
    samples = [StateSample.decode(m.payload) for m in network.puts if m.key == keys.state("a")]
    before = [StateSample.decode(m.received.payload) for m in INPUTS[4:]]
    assert [s.t for s in samples] == [s.t + by for s in before]
    assert [s.seq for s in samples] == [s.seq for s in before]
    assert {s.epoch for s in samples} == {7 + by}
    assert [s.x.tolist() for s in samples] == [s.x.tolist() for s in before]
    (told,) = (Assignment.decode(m.payload) for m in network.puts if m.key == keys.assignment("s", "a"))
    assert told.time_zero == T0 + 10**9 + by
    (text,) = (m.payload for m in network.puts if m.key == keys.document("s"))
    assert text == document(1).payload


def test_what_cannot_be_shifted_comes_as_it_is() -> None:
    network = Network()
    network.time.now = 5.0
    broken = replace(state(0), payload=b"broken")
    with Player(network.bus(), clock=network.time, shift=True) as player:
        player.play([recorded(broken, 0)], threading.Event())
    assert [m.payload for m in network.puts] == [b"broken"]


def test_every_message_with_a_time_is_shifted() -> None:
    by = 10**12
    for message, decode in (
        (event(EventKind.MISS, T0), Event.decode),
        (status(T0), ServiceStatus.decode),
    ):
        assert decode(shifted(message, by)).t == decode(message.payload).t + by
    assert ServiceStatus.decode(shifted(status(T0), by)).started == T0 + by
    for message in (document(1), profile()):
        assert shifted(message, by) == message.payload
    assert ScenarioDocument.decode(shifted(document(1), by)).version == 1
    assert state(0).encoding == state_message.ENCODING


@pytest.mark.parametrize("epoch", [0, 7, 10**18, 2**62])
def test_starts_of_an_agent_stay_in_order_when_they_are_shifted(epoch: int) -> None:
    first, second = state(0, epoch=epoch), state(0, epoch=epoch + 1)
    before, after = (StateSample.decode(shifted(m, 5 * 10**15)).epoch for m in (first, second))
    assert before < after


def test_numbered_messages_are_played_as_they_were_recorded() -> None:
    messages = numbered([state(0), state(1)])
    network, report, _ = play(messages)
    assert [m.payload for m in network.puts] == [m.received.payload for m in messages]
    assert report.published == {"state": 2}


def test_a_tube_is_shifted_with_all_its_times() -> None:
    by = 10**12
    before = examples.a_tube()
    message = Received(keys.tube("a"), before.encode(), "application/msgpack;fleet.tube.v1", T0, "server", T0)
    after = ReachTube.decode(shifted(message, by))
    assert after.t == before.t + by
    assert after.times.tolist() == [t + by for t in before.times.tolist()]
    assert after.server_epoch == before.server_epoch + by
    assert after.center.tolist() == before.center.tolist()
