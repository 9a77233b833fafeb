"""A reverse proxy that has a server under a path, as far as tests need one."""

import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress


@contextmanager
def proxied(port: int, path: str) -> Iterator[str]:
    """Address under which what listens on ``port`` of this machine is to be had below ``path``."""
    with socket.create_server(("127.0.0.1", 0)) as listening:
        threading.Thread(target=_accept, args=(listening, port, path), daemon=True).start()
        yield f"http://127.0.0.1:{listening.getsockname()[1]}{path}/"


def _accept(listening: socket.socket, port: int, path: str) -> None:
    with suppress(OSError):
        while True:
            client, _ = listening.accept()
            threading.Thread(target=_serve, args=(client, port, path), daemon=True).start()


def _serve(client: socket.socket, port: int, path: str) -> None:
    """One request of a connection, or what follows if it becomes a socket."""
    with client, suppress(OSError), socket.create_connection(("127.0.0.1", port)) as server:
        head = b""
        while b"\r\n\r\n" not in head:
            came = client.recv(65536)
            if not came:
                return
            head += came
        method, target, rest = head.split(b" ", 2)
        if not target.startswith(path.encode()):
            client.sendall(b"HTTP/1.1 404 Not Found\r\nContent-Length: 0\r\nConnection: close\r\n\r\n")
            return
        if b"upgrade: websocket" not in head.lower():
            # So that each request has a connection of its own, and its path is rewritten.
            rest = rest.replace(b"keep-alive", b"close")
        server.sendall(method + b" " + (target[len(path) :] or b"/") + b" " + rest)
        threading.Thread(target=_copy, args=(client, server), daemon=True).start()
        _copy(server, client)


def _copy(source: socket.socket, to: socket.socket) -> None:
    with suppress(OSError):
        while came := source.recv(65536):
            to.sendall(came)
    with suppress(OSError):
        to.shutdown(socket.SHUT_WR)
