"""Clients and their sockets: newest wins, and one that is stuck holds up nobody."""

import asyncio
import json
from collections.abc import Coroutine
from typing import Any

import pytest
from starlette.websockets import WebSocketDisconnect

from fleet_dashboard import live
from fleet_dashboard.frames import Viewport
from fleet_dashboard.gateway import Gateway
from fleet_dashboard.view import View, Views
from tests.fleet_dashboard.messages import SECOND, T0, of_profile, of_state, of_tube, tube
from tests.fleet_dashboard.test_frames import read
from tests.fleet_dashboard.test_gateway import fed


class Socket:
    """A client that takes what is sent, until it is stuck; it is gone when its test says so."""

    def __init__(self, *, stuck: bool = False) -> None:
        self.frames: list[bytes] = []
        self.texts: list[dict[str, Any]] = []
        self.said: asyncio.Queue[str | None] = asyncio.Queue()
        self.came = asyncio.Event()
        self._stuck = stuck

    async def send_bytes(self, data: bytes) -> None:
        self.frames.append(data)
        self.came.set()
        if self._stuck:
            await asyncio.Event().wait()

    async def send_text(self, text: str) -> None:
        self.texts.append(json.loads(text))

    async def receive_text(self) -> str:
        text = await self.said.get()
        if text is None:
            raise WebSocketDisconnect
        return text


def run(test: Coroutine[Any, Any, None]) -> None:
    asyncio.run(asyncio.wait_for(test, 60))


async def next_frame(socket: Socket, after: int) -> None:
    while len(socket.frames) <= after:
        socket.came.clear()
        await socket.came.wait()


def serving(socket: Socket, gateway: Gateway, view: View) -> "asyncio.Task[None]":
    async def both() -> None:
        hearing = asyncio.create_task(live._hear(socket, view))  # type: ignore[arg-type]
        await live._send(socket, view, gateway, hearing)  # type: ignore[arg-type]
        assert isinstance(hearing.exception(), WebSocketDisconnect)

    return asyncio.create_task(both())


@pytest.fixture
def gateway(monkeypatch: pytest.MonkeyPatch) -> Gateway:
    monkeypatch.setattr(live, "TICK", 0.001)
    return fed(of_profile("a"), of_state("a", [0, 1, 2, 0]), of_tube(tube("a", at=(1, 2))))[0]


def test_a_stuck_client_holds_up_nobody_and_gets_the_newest_when_it_comes_back(gateway: Gateway) -> None:
    async def test() -> None:
        stuck, healthy = Socket(stuck=True), [Socket() for _ in range(10)]
        tasks = [serving(socket, gateway, View()) for socket in (stuck, *healthy)]
        for socket in (stuck, *healthy):
            await next_frame(socket, 0)
        for k in range(1, 6):
            before = [len(socket.frames) for socket in healthy]
            gateway.tick(T0 + k * SECOND // 10)
            for socket, count in zip(healthy, before, strict=True):
                await next_frame(socket, count)
        assert len(stuck.frames) == 1
        assert {read(socket.frames[-1]).time for socket in healthy} == {T0 / 1e9 + 0.5}
        for socket in (stuck, *healthy):
            socket.said.put_nowait(None)
        for task in tasks[1:]:
            await task
        tasks[0].cancel()

    run(test())


def test_what_was_missed_is_not_sent_later(gateway: Gateway) -> None:
    async def test() -> None:
        socket = Socket()
        task = serving(socket, gateway, View())
        await next_frame(socket, 0)
        for k in range(1, 50):
            gateway.tick(T0 + k * SECOND // 10)
        await next_frame(socket, 1)
        assert [read(frame).time for frame in socket.frames] == [T0 / 1e9, T0 / 1e9 + 4.9]
        # Nothing new, nothing sent.
        for _ in range(20):
            await asyncio.sleep(0)
        assert len(socket.frames) == 2
        socket.said.put_nowait(None)
        await task

    run(test())


def test_a_client_sees_what_it_asks_for_and_is_told_ids_once(gateway: Gateway) -> None:
    async def test() -> None:
        socket, view = Socket(), View()
        task = serving(socket, gateway, view)
        await next_frame(socket, 0)
        assert read(socket.frames[0]).polygons == []
        assert socket.texts[0]["ids"] == ["a"]
        socket.said.put_nowait("no json")
        socket.said.put_nowait(json.dumps({"view": [0, 0, 5, 5], "pixels": 100}))
        await next_frame(socket, 1)
        assert len(read(socket.frames[1]).polygons) == 3
        gateway.feed(of_tube(tube("b")))
        gateway.tick(T0 + 1)
        await next_frame(socket, 2)
        assert [text for text in socket.texts[1:] if "ids" in text] == [{"first": 1, "ids": ["b"]}]
        socket.said.put_nowait(None)
        await task

    run(test())


@pytest.mark.parametrize(
    "text",
    [
        "", "[]", "{}", "[" * 900,
        '{"view": [0, 0, 1, 1]}', '{"view": [0, 0, 1], "pixels": 1}', '{"view": [1, 0, 0, 1], "pixels": 1}',
        '{"view": [0, 0, 1, 1], "pixels": 0}', '{"view": [0, 0, 1, 1], "pixels": NaN}',
        '{"view": [0, 0, 1e300, 1], "pixels": 1}', '{"view": ["a", 0, 1, 1], "pixels": 1}',
        '{"view": [-Infinity, 0, 1, 1], "pixels": 1}',
    ],
)  # fmt: skip
def test_a_view_that_is_none_is_left_alone(text: str) -> None:
    view = View(viewport=Viewport(0, 0, 1, 1, 1))
    view.hear(text)
    assert view.viewport == Viewport(0, 0, 1, 1, 1)


def test_no_view_means_all(gateway: Gateway) -> None:
    view = View(viewport=Viewport(0, 0, 1, 1, 1))
    view.hear('{"view": null, "pixels": 40}')
    assert view.viewport is None


def test_a_view_goes_back_and_on_through_the_past(gateway: Gateway) -> None:
    for k in range(1, 101):
        gateway.tick(T0 + k * SECOND // 10)
    view, now = View(), gateway.clock.time_ns()
    assert view.picture(gateway) is gateway.picture
    view.seek(T0 + 2 * SECOND, 0.0, now)
    assert view.picture(gateway).t == T0 + 2 * SECOND
    assert read(view.frame(gateway, view.picture(gateway))).flags == 1
    gateway.clock.now += 1.0  # type: ignore[attr-defined]
    assert view.picture(gateway).t == T0 + 2 * SECOND
    view.seek(T0 + 2 * SECOND, 2.0, gateway.clock.time_ns())
    gateway.clock.now += 1.5  # type: ignore[attr-defined]
    assert view.picture(gateway).t == T0 + 5 * SECOND
    gateway.clock.now += 100  # type: ignore[attr-defined]
    assert view.picture(gateway).t == T0 + 10 * SECOND
    view.seek(None, 0.0, gateway.clock.time_ns())
    assert view.picture(gateway) is gateway.picture


def test_views_are_bounded_and_an_unknown_one_is_new() -> None:
    views = Views()
    kept = [views.new() for _ in range(600)]
    assert views.find(kept[-1].key) is kept[-1]
    assert views.find(kept[0].key) is not kept[0]
    views.close(kept[-1])
    assert views.find(kept[-1].key) is not kept[-1]
