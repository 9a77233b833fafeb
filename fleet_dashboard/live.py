"""The socket over which a client's frames go: newest wins, and whoever is slow waits alone."""

import asyncio
from typing import Final

from fastapi import FastAPI, WebSocket
from starlette.websockets import WebSocketDisconnect

from fleet_dashboard.gateway import TICK, Gateway
from fleet_dashboard.view import View, Views

#: Bytes of a message that a browser may send: what it says is short.
_MOST_SAID: Final = 1000


def add_live(app: FastAPI, gateway: Gateway, views: Views) -> None:
    """Add the route ``/live/<view>`` to an application."""

    @app.websocket("/live/{key}")
    async def live(socket: WebSocket, key: str) -> None:
        view = views.find(key)
        view.forget()
        await socket.accept()
        hearing = asyncio.create_task(_hear(socket, view))
        try:
            await _send(socket, view, gateway, hearing)
        except (WebSocketDisconnect, RuntimeError, ConnectionError):
            # Gone while something was sent to it.
            pass
        finally:
            hearing.cancel()


async def _hear(socket: WebSocket, view: View) -> None:
    while True:
        text = await socket.receive_text()
        if len(text) <= _MOST_SAID:
            view.hear(text)


async def _send(socket: WebSocket, view: View, gateway: Gateway, hearing: "asyncio.Task[None]") -> None:
    """Send frames until the client is gone.

    ``send_bytes`` waits while the client's buffer is full, in this client's task alone; what it missed meanwhile is not
    made up for: the next frame is that of the newest picture.
    """
    sent: tuple[object, ...] = ()
    while not hearing.done():
        picture = view.picture(gateway)
        # A change of the view is answered at once, not with the next picture.
        what = (picture.number, picture.t, view.viewport, view.sets, view.position)
        if what != sent:
            sent = what
            news = view.news(gateway, picture)
            if news is not None:
                await socket.send_text(news)
            await socket.send_bytes(view.frame(gateway, picture))
        await asyncio.sleep(TICK)
