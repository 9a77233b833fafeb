"""Who may look: everyone on this machine, or who has the token."""

import hmac
import ipaddress
from http.cookies import CookieError, SimpleCookie
from typing import Final
from urllib.parse import parse_qsl, urlencode, urlsplit

from starlette.datastructures import Headers
from starlette.responses import PlainTextResponse, RedirectResponse
from starlette.types import ASGIApp, Receive, Scope, Send

COOKIE: Final = "fleet_token"
#: Close code of a WebSocket that is refused by policy.
_POLICY: Final = 1008


def is_loopback(host: str) -> bool:
    """Whether only programs of this machine reach what listens on ``host``."""
    try:
        return ipaddress.ip_address(host.strip("[]")).is_loopback
    except ValueError:
        return host == "localhost"


class Guard:
    """Lets requests and sockets through to ``app`` that may come.

    With a ``token``: who has it as a cookie, or brings it as ``?token=…`` and is given the cookie. Without: who names
    this machine as it is named here, which a page of another site that a browser shows cannot. In both cases a socket
    must come from a page of this server, since browsers let any page open sockets, with the cookie.
    """

    def __init__(self, app: ASGIApp, token: str | None) -> None:
        self._app = app
        self._token = token

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer, or hand on."""
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        headers = Headers(scope=scope)
        refusal = self._refusal(scope, headers)
        if refusal is None:
            await self._app(scope, receive, send)
        elif scope["type"] == "websocket":
            # Refused before it was accepted; the handshake is answered with 403.
            await receive()
            await send({"type": "websocket.close", "code": _POLICY, "reason": refusal})
        else:
            await self._answer(refusal, scope, headers)(scope, receive, send)

    def _refusal(self, scope: Scope, headers: Headers) -> str | None:
        """Why it may not pass; None if it may."""
        if _foreign(scope, headers):
            return "this socket was opened by a page of another site"
        if self._token is None:
            if is_loopback(_name(headers.get("host", ""))):
                return None
            return "this page is for this machine only: start it with --host and a token to look from elsewhere"
        if same(_cookie(headers), self._token):
            return None
        return "a token is needed: open the address that `fleet dashboard` has printed"

    def _answer(self, refusal: str, scope: Scope, headers: Headers) -> ASGIApp:
        query = parse_qsl(scope.get("query_string", b"").decode("latin-1"), keep_blank_values=True)
        given = next((value for name, value in query if name == "token"), "")
        if self._token is None or _foreign(scope, headers) or not same(given, self._token):
            return PlainTextResponse(refusal + "\n", 403 if self._token is None else 401)
        # The token leaves the address bar, so that it does not stay in histories and pictures of the screen.
        rest = urlencode([(name, value) for name, value in query if name != "token"])
        # Relative, since a proxy may have this page under another path.
        here = "./" + scope["path"].rpartition("/")[2]
        answer = RedirectResponse(here + (f"?{rest}" if rest else ""), 303)
        secure = scope["scheme"] == "https" or headers.get("x-forwarded-proto") == "https"
        answer.set_cookie(COOKIE, self._token, httponly=True, samesite="lax", secure=secure)
        return answer


def same(given: str, token: str) -> bool:
    """Whether two tokens are equal; how long that takes says nothing about where they differ."""
    return hmac.compare_digest(given.encode(), token.encode())


def _foreign(scope: Scope, headers: Headers) -> bool:
    """Whether a socket was opened by a page of another site; NiceGUI has long polls where sockets are not to be had."""
    origin = headers.get("origin")
    live = scope["type"] == "websocket" or scope["path"].rstrip("/").endswith("/socket.io")
    return live and origin is not None and origin.partition("://")[2] != headers.get("host", "")


def _name(host: str) -> str:
    """The name in a header of a host; empty if there is none."""
    try:
        return urlsplit(f"//{host}").hostname or ""
    except ValueError:
        return ""


def _cookie(headers: Headers) -> str:
    try:
        found = SimpleCookie(headers.get("cookie", "")).get(COOKIE)
    except CookieError:
        return ""
    return "" if found is None else found.value
