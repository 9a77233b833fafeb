"""A fleet that is restored from a snapshot goes on as the one that it was taken of, to the last bit."""

import functools
import os
from collections import deque
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgpack
import numpy as np
import pytest

from fleet_bus.messages import Assignment, Label, StateFlag, VehicleProfile
from fleet_bus.rejections import Rejections
from fleet_bus.writers import Source
from reach_server.service import object_graph as graph
from reach_server.service import object_reader, object_writer, tube_messages
from reach_server.service.fleet import Fleet
from reach_server.service.ingest import VehicleBatch
from reach_server.service.journal import event_digest
from reach_server.service.object_graph import CheckpointError
from tests.fleet_recorder.drive import region
from tests.reach_server.drives import PROFILE, START, SVEA
from tests.reach_server.service.fleet_desk import Desk

FULL = 130

METHODS: dict[str, dict[str, Any]] = {
    "set_membership": {"window": 120},
    "constrained": {"window": 120, "cuts": "constrained"},
    "frobenius": {"window": 120, "cuts": "frobenius"},
    "reservoir": {"window": 60, "reservoir": 40},
    "residual_hull": {"window": 100, "method": "residual_hull"},
    "paper": {"window": 100, "method": "paper", "frame": "world", "lipschitz": None},
    "lti": {"window": 110, "method": "lti", "frame": "world", "lipschitz": None},
    "calibrated": {"window": 200, "method": "calibrated", "confidence": 0.8, "lipschitz": None},
}


def results(fleet: Fleet, batches: list[VehicleBatch], now: float) -> list[object]:
    """All that a round leads to, as it is published."""
    outcome = fleet.process(batches, now)
    found: list[object] = [
        tube.encode()
        for tube in tube_messages.of_round(outcome.tubes, None, server="one", server_epoch=START, compute_seconds=0.0)
    ]
    found += [event_digest(event) for event in (*outcome.events, *fleet.elapse(now))]
    return [*found, outcome.stored, outcome.repeated, fleet.let_go(now)]


def stamp() -> int:
    return START


class Pair:
    """A desk, and another one that has got its fleet by a snapshot."""

    def __init__(self) -> None:
        self.desk = Desk()
        self.desk.fleet = Fleet(self.desk.rejections, stamp)

    def restored(self) -> Fleet:
        return Fleet.restored(self.desk.fleet.snapshot(), Rejections(), stamp)

    def goes_on_alike(self, rounds: Iterator[list[VehicleBatch]]) -> int:
        """Hold the two against each other; how many tubes there were."""
        other, tubes = self.restored(), 0
        for k, batches in enumerate(rounds):
            now = 100.0 + k * SVEA.dt
            here, there = (results(fleet, batches, now) for fleet in (self.desk.fleet, other))
            assert here == there, f"round {k}"
            tubes += sum(isinstance(result, bytes) and len(result) > 100 for result in here)
        assert [e.vehicles for e in other.engines] == [e.vehicles for e in self.desk.fleet.engines]
        return tubes


def scenarios(fleet: Fleet, *vehicles: str, at: int = FULL) -> None:
    for name, half in (("near", 1.0), ("far", 20.0)):
        fleet.set_scenario(region(name, half, at=at))
        for vehicle in vehicles:
            zero = START + at * SVEA.dt_ns
            fleet.assign(Assignment(scenario=name, vehicle=vehicle, time_zero=zero))


@pytest.mark.slow
@pytest.mark.parametrize("method", METHODS)
def test_every_method_goes_on_as_before(method: str) -> None:
    pair = Pair()
    pair.desk.fleet.set_profile("a", PROFILE.model_copy(update=METHODS[method]))
    pair.desk.fleet.set_profile("b", PROFILE.model_copy(update=METHODS[method]))
    full = FULL if method != "calibrated" else 260
    scenarios(pair.desk.fleet, "a", at=full)

    def samples(start: int, stop: int) -> list[VehicleBatch]:
        return [pair.desk.states(v, start, stop, planned=True, late=0.01) for v in ("a", "b")]

    pair.desk.process(*samples(0, full))
    for k in range(full, full + 6):
        # In the middle of a scenario, with predictions that wait to be checked.
        pair.desk.process(*samples(k, k + 1))
    assert pair.goes_on_alike(samples(k, k + 1) for k in range(full + 6, full + 20)) == 28


@pytest.mark.slow
def test_what_waits_and_who_came_and_went_goes_on_as_before() -> None:
    pair = Pair()
    desk, fleet = pair.desk, pair.desk.fleet
    small = PROFILE.model_copy(update={"window": 120})
    for vehicle in ("a", "gone", "b"):
        fleet.set_profile(vehicle, small)
        desk.process(desk.states(vehicle, 0, FULL, planned=True, flags=StateFlag.HISTORY), now=1.0)
    scenarios(fleet, "gone", "b")
    fleet.mark_gone("gone")
    desk.process(desk.states("a", FULL, FULL + 1), desk.states("b", FULL, FULL + 1), now=900.0)
    assert fleet.let_go(900.0) == ["gone"]
    # One takes its slot, one has no profile, and of one another session writes as well.
    fleet.set_profile("new", small)
    desk.process(desk.states("new", 0, FULL, planned=True), desk.states("unknown", 0, 40, planned=True), now=900.1)
    for k in (1, 2):
        desk.process(
            desk.states("a", FULL + k, FULL + k + 1, planned=True),
            desk.states("a", k, k + 1, session="other"),
            now=900.2,
        )
    assert fleet.waits_for_profile("unknown")

    def rounds() -> Iterator[list[VehicleBatch]]:
        for k in range(FULL + 3, FULL + 12):
            yield [desk.states(v, k, k + 1, planned=True) for v in ("a", "b", "new")]
        yield [desk.states("unknown", 40, 41, planned=True)]

    other = pair.restored()
    for each in (fleet, other):
        each.set_profile("unknown", small)
    for k, batches in enumerate(rounds()):
        assert results(fleet, batches, 901.0 + k) == results(other, batches, 901.0 + k), k
    assert fleet.vehicles == other.vehicles
    assert {v: fleet.window_keys(v) for v in fleet.vehicles} == {v: other.window_keys(v) for v in fleet.vehicles}


@pytest.mark.slow
def test_a_snapshot_changes_nothing_and_shares_nothing() -> None:
    pair = Pair()
    desk, fleet = pair.desk, pair.desk.fleet
    fleet.set_profile("a", PROFILE.model_copy(update={"window": 120}))
    desk.process(desk.states("a", 0, FULL, planned=True))
    first = fleet.snapshot()
    other = pair.restored()
    assert fleet.snapshot() == first
    other.process([desk.states("a", FULL, FULL + 5, planned=True)], 1.0)
    assert fleet.snapshot() == first
    assert other.snapshot() != first


# --- the codec --------------------------------------------------------------------------------------------------------
def again(value: object) -> Any:
    return object_reader.load(object_writer.dump(value, {}), {})


def test_values_come_back_as_they_are() -> None:
    values = [
        None, True, 1, -(2**63), 2**64 - 1, 2**200, -(2**200), 0.1, -0.0, float("inf"), "é", b"\0", (), (1, (2.0, "x")),
        [1, [2]], {"a": 1, 2: [3]}, {1, 2}, frozenset({3, 4}), deque([1], maxlen=3), np.float64(0.1), np.int64(3),
        Label.GUARANTEED, StateFlag.HISTORY | StateFlag.BOUND, Source("s", 3),
    ]  # fmt: skip
    found = again(values)
    assert found == values
    assert [type(v) for v in found] == [type(v) for v in values]
    assert str(found[8]) == "-0.0"
    assert found[18].maxlen == 3
    assert np.isnan(again([float("nan")])[0])


def test_what_is_shared_is_shared_again_and_what_holds_itself_does() -> None:
    inner: list[object] = [1]
    outer: list[object] = [inner, inner, (inner,)]
    outer.append(outer)
    found = again(outer)
    assert found[0] is found[1] is found[2][0]
    assert found[3] is found


def test_arrays_keep_their_order_their_strides_and_the_memory_that_they_share() -> None:
    base = np.arange(24.0).reshape(4, 6)
    arrays = [
        base, base[1:, ::2], base.T, np.asfortranarray(base), np.broadcast_to(base[0], (3, 6)), base[::-1], base[:0],
        np.zeros((0, 3)), np.zeros(3, dtype=bool), np.frombuffer(b"12345678", dtype="<u8"), np.array(5.0),
    ]  # fmt: skip
    found = again(arrays)
    for was, now in zip(arrays, found, strict=True):
        assert np.array_equal(was, now)
        assert (was.dtype, was.strides, was.shape) == (now.dtype, now.strides, now.shape)
        assert was.flags.c_contiguous == now.flags.c_contiguous
        assert was.flags.writeable == now.flags.writeable
        assert now.flags.aligned
    found[0][1, 0] = -1.0
    assert found[1][0, 0] == found[2][0, 1] == found[5][2, 0] == -1.0
    assert found[3][1, 0] == 6.0


class Foreign:
    pass


@pytest.mark.parametrize(
    "value",
    [
        Foreign(), Path("x"), os.system, lambda: 1, functools.partial(int), np.array(["x"]), np.array([1j]),
        frozenset({Source("s")}), object(), Desk, {1: Foreign()},
    ],
)  # fmt: skip
def test_what_could_not_be_restored_is_not_written(value: object) -> None:
    with pytest.raises(CheckpointError):
        object_writer.dump(value, {})


def packed(*records: tuple[Any, ...]) -> bytes:
    return b"".join(msgpack.packb(record) for record in records)


REFUSED: dict[str, bytes] = {
    "a class of another module": packed((graph.CLASS, "os", "_Environ", [])),
    "a class that was reached through a module": packed((graph.CLASS, "reach_server.engine.engine", "np.ndarray", [])),
    "a class that was imported": packed((graph.CLASS, "reach_server.service.fleet", "Rejections", [])),
    "a name that is no class": packed((graph.CLASS, "reach_server.engine.engine", "notices", [])),
    "a function": packed((graph.CLASS, "reach_server.methods.registry", "find", [])),
    "a module that is not loaded": packed((graph.CLASS, "reach_server.engine.nothing", "X", [])),
    "a module beside the allowed ones": packed((graph.CLASS, "reach_server.enginex", "X", [])),
    "other attributes": packed((graph.CLASS, "reach_server.service.registry", "VehicleRegistry", ["x"])),
    "a method that there is not": packed(
        (graph.CLASS, "reach_server.service.registry", "VehicleRegistry", []),
        (graph.OBJECT, 0),
        (graph.METHOD, [0], "__class__"),
    ),
    "a method of a list": packed((graph.LIST,), (graph.METHOD, [0], "append")),
    "attributes that a class has not": packed(
        (graph.CLASS, "fleet_bus.writers", "Writer", []), (graph.OBJECT, 0), (graph.FILL, 0, *range(9), "x", 1)
    ),
    "an array beyond its memory": packed((graph.MEMORY, b"12345678"), (graph.ARRAY, [0], "<f8", [2], [8], 0, True)),
    "an array before its memory": packed((graph.MEMORY, b"12345678"), (graph.ARRAY, [0], "<f8", [1], [8], -8, True)),
    "an array of objects": packed((graph.MEMORY, b"12345678"), (graph.ARRAY, [0], "O", [1], [8], 0, True)),
    "an array that is too large": packed((graph.MEMORY, b"12345678"), (graph.ARRAY, [0], "<f8", [2**40], [0], 0, True)),
    "a reference to what is not there": packed((graph.TUPLE, [5])),
    "a reference backwards": packed((graph.LIST,), (graph.TUPLE, [-1])),
    "a kind that there is not": packed((99,)),
    "something given that is not": packed((graph.GIVEN, "clock")),
    "an operation that there is not": packed((graph.OPERATION, 12345)),
    "a member that there is not": packed(
        (graph.CLASS, "fleet_bus.messages.tube", "Label", []), (graph.ENUM, 0, "MINE")
    ),
    "an object of a named tuple": packed((graph.CLASS, "fleet_bus.writers", "Source", []), (graph.OBJECT, 0)),
    "a named tuple of another length": packed(
        (graph.CLASS, "fleet_bus.writers", "Source", []), (graph.NAMED_TUPLE, 0, "a")
    ),
    "a key that has no hash": packed((graph.DICT,), (graph.LIST,), (graph.FILL, 0, [1], 1)),
    "nothing": b"",
    "no record": packed(()),
    "half a record": packed((graph.TUPLE, 1, 2))[:-1],
    "no msgpack": b"\xc1",
    "pickle": b"\x80\x04N.",
}


@pytest.mark.parametrize("what", REFUSED)
def test_bytes_that_no_fleet_wrote_are_refused(what: str) -> None:
    with pytest.raises(CheckpointError):
        object_reader.load(REFUSED[what], {})


@pytest.mark.slow
def test_a_snapshot_that_is_cut_or_altered_is_refused_or_read_but_never_more() -> None:
    desk = Desk()
    desk.fleet.set_profile("a", PROFILE.model_copy(update={"window": 30}))
    desk.process(desk.states("a", 0, 20))
    whole = desk.fleet.snapshot()
    rng = np.random.default_rng(0)
    for place in rng.integers(0, len(whole), 300).tolist():
        altered = bytearray(whole)
        altered[place] ^= 1 << int(rng.integers(8))
        for data in (bytes(altered), whole[:place]):
            try:
                Fleet.restored(data, Rejections())
            except CheckpointError:
                continue


def test_a_snapshot_of_something_else_is_no_fleet() -> None:
    with pytest.raises(CheckpointError, match="a list where a fleet is expected"):
        Fleet.restored(object_writer.dump([], {"rejections": Rejections(), "stamp": stamp}), Rejections())


def test_profiles_come_back_with_all_that_they_are() -> None:
    found: VehicleProfile = again(PROFILE)
    assert found == PROFILE
    assert found.encode() == PROFILE.encode()
    assert found.model_fields_set == PROFILE.model_fields_set
