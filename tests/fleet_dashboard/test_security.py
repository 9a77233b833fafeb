"""Who may look."""

import asyncio
import hmac
from dataclasses import dataclass
from typing import Any

import pytest
from starlette.types import Message, Receive, Scope, Send

from fleet_bus.errors import FleetError, UsageError
from fleet_dashboard.security import COOKIE, Guard, is_loopback, same
from fleet_dashboard.serving import Address, listen

TOKEN = "correct-horse-battery"
HERE = "127.0.0.1:8080"


@dataclass
class Answer:
    """Status of what was asked for; 200 came from behind the guard, 403 of a socket is its refusal."""

    status: int
    headers: dict[str, str]


async def _behind(scope: Scope, receive: Receive, send: Send) -> None:
    if scope["type"] == "websocket":
        await send({"type": "websocket.accept"})
    else:
        await send({"type": "http.response.start", "status": 200, "headers": []})
        await send({"type": "http.response.body", "body": b""})


def ask(token: str | None, target: str, host: str = HERE, *, kind: str = "http", **headers: str) -> Answer:
    """What the guard answers; underscores in names of headers are dashes."""
    path, _, query = target.partition("?")
    named = {"host": host, **{name.replace("_", "-"): value for name, value in headers.items()}}
    scope: dict[str, Any] = {
        "type": kind, "path": path, "query_string": query.encode(), "scheme": "http", "method": "GET",
        "headers": [(name.encode(), value.encode()) for name, value in named.items()],
    }  # fmt: skip
    sent: list[Message] = []

    async def receive() -> Message:
        return {"type": f"{kind}.connect"}

    async def send(message: Message) -> None:
        sent.append(message)

    asyncio.run(Guard(_behind, token)(scope, receive, send))
    first = sent[0]
    if kind == "websocket":
        return Answer(200 if first["type"] == "websocket.accept" else 403, {})
    return Answer(first["status"], {name.decode(): value.decode() for name, value in first["headers"]})


def socket(token: str | None, host: str = HERE, **headers: str) -> int:
    return ask(token, "/live/k", host, kind="websocket", **headers).status


@pytest.mark.parametrize("host", [HERE, "localhost:8080", "[::1]:8080", "127.0.0.1"])
def test_this_machine_may_look_without_a_token(host: str) -> None:
    assert ask(None, "/vehicle/a", host).status == 200
    assert socket(None, host, origin=f"http://{host}") == 200
    # A program that is no browser sends no origin.
    assert socket(None, host) == 200


@pytest.mark.parametrize(
    "host", ["evil.example", "127.0.0.1.evil.example", "192.168.1.5:8080", "", "[::1", "127.0.0.1@evil.example"]
)
def test_a_name_that_was_made_to_point_here_is_refused(host: str) -> None:
    assert ask(None, "/vehicle/a", host).status == 403
    assert socket(None, host) == 403


def test_a_token_is_asked_for_and_becomes_a_cookie_and_leaves_the_address() -> None:
    host = "fleet.example:8080"
    assert ask(TOKEN, "/vehicle/a", host).status == 401
    assert ask(TOKEN, "/vehicle/a?token=correct-horse-batterx", host).status == 401
    assert ask(TOKEN, "/vehicle/a", host, cookie=f"{COOKIE}=wrong").status == 401
    assert ask(TOKEN, "/vehicle/a", host, cookie="\x01;;=").status == 401
    assert socket(TOKEN, host) == 403
    # Nor is a socket let through by its address: that would stay in logs.
    assert ask(TOKEN, f"/live/k?token={TOKEN}", host, kind="websocket").status == 403
    answer = ask(TOKEN, f"/vehicle/a?x=1&token={TOKEN}", host)
    assert answer.status == 303
    assert answer.headers["location"] == "./a?x=1"
    cookie = answer.headers["set-cookie"]
    assert cookie.startswith(f"{COOKIE}={TOKEN};")
    assert "HttpOnly" in cookie
    assert "SameSite=lax" in cookie
    assert "Secure" not in cookie
    assert ask(TOKEN, "/vehicle/a", host, cookie=f"other=1; {COOKIE}={TOKEN}").status == 200
    assert socket(TOKEN, host, cookie=f"{COOKIE}={TOKEN}", origin=f"http://{host}") == 200


@pytest.mark.parametrize("path", ["//evil.example/x", "/\\evil.example/x", "//evil.example", "/a//b:c"])
def test_a_path_cannot_lead_to_another_site(path: str) -> None:
    assert ask(TOKEN, f"{path}?token={TOKEN}").headers["location"].startswith("./")


@pytest.mark.parametrize("origin", ["http://evil.example", "null", "http://127.0.0.1:9999", ""])
def test_a_socket_that_another_page_opens_is_refused(origin: str) -> None:
    assert socket(None, origin=origin) == 403
    assert socket(TOKEN, origin=origin, cookie=f"{COOKIE}={TOKEN}") == 403
    poll = "/_nicegui_ws/socket.io/"
    assert ask(None, poll, origin=origin).status == 403
    assert ask(TOKEN, poll, origin=origin, cookie=f"{COOKIE}={TOKEN}").status in (401, 403)
    assert ask(None, poll, origin=f"http://{HERE}").status == 200


def test_a_poll_of_another_page_gets_no_cookie_either() -> None:
    answer = ask(TOKEN, f"/_nicegui_ws/socket.io/?token={TOKEN}", origin="http://evil.example")
    assert "set-cookie" not in answer.headers


def test_behind_a_proxy_with_https_the_cookie_stays_there() -> None:
    answer = ask(TOKEN, f"/?token={TOKEN}", x_forwarded_proto="https")
    assert "Secure" in answer.headers["set-cookie"]
    assert answer.headers["location"] == "./"


def test_tokens_are_compared_in_constant_time(monkeypatch: pytest.MonkeyPatch) -> None:
    compared = []
    real = hmac.compare_digest

    def compare(a: bytes, b: bytes) -> bool:
        compared.append((a, b))
        return real(a, b)

    monkeypatch.setattr(hmac, "compare_digest", compare)
    assert not same("aé", TOKEN)
    assert len(compared) == 1


def test_what_is_reached_from_this_machine_only() -> None:
    assert all(map(is_loopback, ("127.0.0.1", "127.1.2.3", "::1", "[::1]", "localhost")))
    assert not any(map(is_loopback, ("0.0.0.0", "::", "192.168.0.1", "fleet.example", "localhost.evil.example", "")))


def test_another_host_gets_a_token_and_this_one_needs_none() -> None:
    listening, address = listen("127.0.0.1", 0, None)
    with listening:
        assert address.token is None
        assert address.url == f"http://127.0.0.1:{address.port}/"
    listening, address = listen("0.0.0.0", 0, None)
    with listening:
        assert address.token is not None
        assert len(address.token) >= 30
        assert address.url.endswith(f":{address.port}/?token={address.token}")
    assert Address("::1", 8080, None).url == "http://[::1]:8080/"


@pytest.mark.parametrize("token", ["", "short", "with blank in it", "naïve-token-x", "a&b=cdefgh"])
def test_a_token_that_cannot_be_one_is_refused(token: str) -> None:
    with pytest.raises(UsageError, match="--token"):
        listen("127.0.0.1", 0, token)


def test_a_taken_port_is_said_or_the_next_one_taken() -> None:
    first, address = listen("127.0.0.1", 0, None)
    with first:
        with pytest.raises(FleetError, match=f"port {address.port} of 127.0.0.1 is taken.*--port"):
            listen("127.0.0.1", address.port, None)
        second, other = listen("127.0.0.1", address.port, None, search=True)
        with second:
            assert address.port < other.port <= address.port + 50


def test_an_address_that_is_not_here_is_said() -> None:
    with pytest.raises(FleetError, match=r"cannot listen on 192\.0\.2\.1"):
        listen("192.0.2.1", 0, None)
