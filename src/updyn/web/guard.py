"""`Guard`: access control of the server, and limits on the size of requests.

Every page open in a browser, and every user of the machine, can send requests to the server. A
request must have the printed secret, the printed host name, and a page of the server as origin.
"""

from __future__ import annotations

import hmac
from collections.abc import Awaitable, Callable, Mapping, MutableMapping
from typing import Any
from urllib.parse import parse_qs, quote, urlencode

__all__ = ["Guard"]

Scope = MutableMapping[str, Any]
Message = MutableMapping[str, Any]
Receive = Callable[[], Awaitable[Message]]
Send = Callable[[Message], Awaitable[None]]
App = Callable[[Scope, Receive, Send], Awaitable[None]]

_TOKEN = "token"
#: Content security policy of a page: it may load nothing from other hosts. The framework creates
#: functions from text, and styles of single elements.
_POLICY = (
    "default-src 'self'; script-src 'self' 'unsafe-inline' 'unsafe-eval'; style-src 'self'"
    " 'unsafe-inline'; img-src 'self' data: blob:; font-src 'self' data:; connect-src 'self'"
    " ws://{host}; frame-ancestors 'self'; base-uri 'self'; form-action 'self'; object-src 'none'"
)
#: Other rules for browsers.
_RULES = {
    "x-content-type-options": "nosniff",
    "referrer-policy": "no-referrer",
    "cross-origin-resource-policy": "same-origin",
}
#: Status of WebSocket for a message against the rules (RFC 6455, section 7.4.1).
_AGAINST_THE_RULES = 1008


class Guard:
    """An ASGI application that passes on permitted requests and refuses others before reading them.

    The first request has the secret as ``?token=...`` and is answered by a cookie. A body has at
    most `most_bytes` bytes.
    """

    def __init__(self, app: App, *, port: int, token: str, most_bytes: int) -> None:
        self._app = app
        self._hosts = {f"127.0.0.1:{port}", f"localhost:{port}"}
        self._cookie = f"updyn-{port}"  # cookies do not distinguish ports
        self._token = token
        self._most_bytes = most_bytes

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer a request, or pass it on."""
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        headers = _headers(scope)
        refusal = self._refusal(scope, headers)
        if refusal is not None:
            await _refuse(scope, receive, send, *refusal)
        elif scope["type"] == "websocket":
            await self._app(scope, receive, send)
        elif self._find_token(scope) is not None:
            await self._set_cookie(scope, send)
        else:
            await self._pass_on(scope, receive, _add_rules(send, headers["host"]))

    def _refusal(self, scope: Scope, headers: Mapping[str, str]) -> tuple[int, str] | None:
        """Return status and reason of a refusal; None for a permitted request."""
        if headers.get("host") not in self._hosts:
            return 421, "This server answers under the address that it printed, and no other."
        origin = headers.get("origin")
        origins = {f"http://{host}" for host in self._hosts}
        if origin not in origins and (origin is not None or scope["type"] == "websocket"):
            return 403, "A page of another address has asked."
        if not self._has_token(scope, headers):
            return 401, "The secret is missing: open the address that updyn serve printed."
        length = headers.get("content-length", "0")
        # A number of more digits is too large, and Python does not convert thousands of digits.
        readable = length.isdecimal() and len(length) <= len(str(self._most_bytes))
        if not readable or int(length) > self._most_bytes:
            return self._too_large
        return None

    @property
    def _too_large(self) -> tuple[int, str]:
        """Status and reason of the refusal of a large body."""
        return 413, f"At most {self._most_bytes // 2**20} MB can be sent at once."

    async def _pass_on(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Let the application answer, unless the body proves too large before it does."""
        limit = _Limit(receive, send, self._most_bytes, self._too_large)
        try:
            await self._app(scope, limit.receive, limit.send)
        except Exception:
            if not limit.exceeded:  # otherwise the application reports a truncated body
                raise

    def _find_token(self, scope: Scope) -> str | None:
        asked = parse_qs(scope.get("query_string", b"").decode("latin-1")).get(_TOKEN)
        return asked[0] if asked else None

    def _has_token(self, scope: Scope, headers: Mapping[str, str]) -> bool:
        """Return whether the secret is in the address or in the cookie."""
        asked = self._find_token(scope) if scope["type"] == "http" else None
        given = _cookies(headers, self._cookie) if asked is None else [asked]
        secret = self._token.encode()
        return any(hmac.compare_digest(each.encode(), secret) for each in given)

    async def _set_cookie(self, scope: Scope, send: Send) -> None:
        """Keep the secret in a cookie, and lead to the same page without it in the address."""
        asked = parse_qs(scope["query_string"].decode("latin-1"))
        asked.pop(_TOKEN)
        rest = urlencode(asked, doseq=True)
        # Quoted: browsers take a backslash for a slash, and "//name" for another server.
        place = "/" + quote(scope["path"].lstrip("/")) + ("?" + rest if rest else "")
        cookie = f"{self._cookie}={self._token}; Path=/; HttpOnly; SameSite=Strict"
        headers = {"location": place, "set-cookie": cookie, "cache-control": "no-store"}
        await _answer(send, 303, "", headers)


def _headers(scope: Scope) -> dict[str, str]:
    """Return the headers of a request by lower-case name."""
    return {
        name.decode("latin-1").lower(): value.decode("latin-1")
        for name, value in scope.get("headers", ())
    }


def _cookies(headers: Mapping[str, str], name: str) -> list[str]:
    """Return the values of a cookie.

    Cookies are not separated by port: those of other programs on this machine are included, and
    `http.cookies` may fail on them.
    """
    pairs = [part.partition("=") for part in headers.get("cookie", "").split(";")]
    return [value.strip() for key, _, value in pairs if key.strip() == name]


async def _refuse(scope: Scope, receive: Receive, send: Send, status: int, reason: str) -> None:
    if scope["type"] == "websocket":
        await receive()  # the connection request, which must be received before the answer
        await send({"type": "websocket.close", "code": _AGAINST_THE_RULES, "reason": reason})
    else:
        await _answer(send, status, reason, {"connection": "close"})


async def _answer(send: Send, status: int, text: str, headers: Mapping[str, str]) -> None:
    body = f"{text}\n".encode() if text else b""
    all_headers = {
        "content-type": "text/plain; charset=utf-8",
        "content-length": str(len(body)),
        "content-security-policy": "default-src 'none'",
        **_RULES,
        **headers,
    }
    encoded = [(name.encode(), value.encode("latin-1")) for name, value in all_headers.items()]
    await send({"type": "http.response.start", "status": status, "headers": encoded})
    await send({"type": "http.response.body", "body": body})


class _Limit:
    """A request whose body is truncated at `most` bytes, and then refused."""

    def __init__(self, receive: Receive, send: Send, most: int, refusal: tuple[int, str]) -> None:
        self._receive, self._send = receive, send
        self._left = most
        self._refusal = refusal
        self._begun = False
        self.exceeded = False

    async def receive(self) -> Message:
        """Return the next message; the end of the request where the body is too large."""
        if self.exceeded:
            return {"type": "http.disconnect"}
        message = await self._receive()
        self._left -= len(message.get("body", b""))
        if self._left >= 0:
            return message
        self.exceeded = True
        if not self._begun:
            await _answer(self._send, *self._refusal, {"connection": "close"})
        return {"type": "http.disconnect"}

    async def send(self, message: Message) -> None:
        """Pass on a message of the application, unless the request was refused."""
        if self._begun or not self.exceeded:
            self._begun = True
            await self._send(message)


def _add_rules(send: Send, host: str) -> Send:
    """Return a sink that adds the rules for browsers to every answer."""
    added = {
        b"content-security-policy": _POLICY.format(host=host).encode(),
        **{name.encode(): value.encode() for name, value in _RULES.items()},
    }

    async def send_with_rules(message: Message) -> None:
        if message["type"] == "http.response.start":
            given = list(message.get("headers", ()))
            present = {name.lower() for name, _ in given}
            missing = [pair for pair in added.items() if pair[0] not in present]
            message = {**message, "headers": [*given, *missing]}
        await send(message)

    return send_with_rules
