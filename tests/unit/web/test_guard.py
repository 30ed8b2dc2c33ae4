"""What passes the guard and what does not: by direct calls, and over a socket of this machine."""

from __future__ import annotations

import asyncio
import threading
import time
from collections.abc import Iterator
from typing import Any

import httpx
import pytest
import uvicorn
from fastapi import FastAPI, Request

from updyn.web.guard import Guard
from updyn.web.server import bind

PORT, TOKEN, MOST = 8123, "a-secret_of-the-server", 3 * 2**20
OWN = f"127.0.0.1:{PORT}"
COOKIE = f"updyn-{PORT}={TOKEN}"


class Inner:
    """An application that keeps what reached it and answers with the size of the body."""

    def __init__(self, headers: list[tuple[bytes, bytes]] | None = None) -> None:
        self.seen: list[dict[str, Any]] = []
        self.headers = headers or []

    async def __call__(self, scope: Any, receive: Any, send: Any) -> None:
        body = b""
        while scope["type"] == "http":
            message = await receive()
            if message["type"] != "http.request":
                body = b"left"
                break
            body += message["body"]
            if not message.get("more_body", False):
                break
        self.seen.append({"type": scope["type"], "body": body})
        if scope["type"] == "http" and body != b"left":
            await send({"type": "http.response.start", "status": 200, "headers": self.headers})
            await send({"type": "http.response.body", "body": b"%d" % len(body)})


def ask(
    inner: Inner | None = None,
    *,
    kind: str = "http",
    path: str = "/",
    query: bytes = b"",
    headers: dict[str, str] | None = None,
    chunks: tuple[bytes, ...] = (b"",),
) -> tuple[list[dict[str, Any]], Inner]:
    """Call the guard once, as a server does; return what it sent, and the application behind it."""
    inner = inner or Inner()
    given = {"host": OWN, "cookie": COOKIE, **(headers or {})}
    scope = {
        "type": kind,
        "path": path,
        "query_string": query,
        "headers": [(k.encode(), v.encode("latin-1")) for k, v in given.items() if v],
    }
    coming = [
        {"type": "http.request", "body": chunk, "more_body": number < len(chunks) - 1}
        for number, chunk in enumerate(chunks)
    ]
    if kind == "websocket":
        coming = [{"type": "websocket.connect"}]
    sent: list[dict[str, Any]] = []

    async def receive() -> dict[str, Any]:
        return coming.pop(0) if coming else {"type": "http.disconnect"}

    async def send(message: dict[str, Any]) -> None:
        sent.append(dict(message))

    asyncio.run(Guard(inner, port=PORT, token=TOKEN, most_bytes=MOST)(scope, receive, send))
    return sent, inner


def status(sent: list[dict[str, Any]]) -> int:
    assert [m["type"] for m in sent] == ["http.response.start", "http.response.body"]
    return sent[0]["status"]


def headers_of(sent: list[dict[str, Any]]) -> dict[str, str]:
    return {name.decode().lower(): value.decode() for name, value in sent[0]["headers"]}


# -- who may ask
@pytest.mark.parametrize("host", [OWN, f"localhost:{PORT}"])
@pytest.mark.parametrize("origin", ["", f"http://{OWN}", f"http://localhost:{PORT}"])
def test_a_page_of_the_server_with_the_cookie_passes(host, origin):
    sent, inner = ask(headers={"host": host, "origin": origin}, chunks=(b"ab", b"c"))
    assert status(sent) == 200
    assert inner.seen == [{"type": "http", "body": b"abc"}]


@pytest.mark.parametrize(
    ("expected", "headers", "query"),
    [
        (401, {"cookie": ""}, b""),
        (401, {"cookie": f"updyn-{PORT}=another"}, b""),
        (401, {"cookie": f"updyn-{PORT + 1}={TOKEN}"}, b""),
        (401, {"cookie": f"updyn-{PORT}="}, b"token="),
        (401, {"cookie": ""}, b"token=another"),
        (401, {"cookie": ""}, "token=\u00e9\u00fc".encode("latin-1")),
        (421, {"host": f"elsewhere.example:{PORT}"}, b""),
        (421, {"host": "127.0.0.1"}, b""),
        (421, {"host": f"127.0.0.1:{PORT + 1}"}, b""),
        (421, {"host": ""}, b""),
        (421, {"host": f"elsewhere.example:{PORT}", "cookie": ""}, f"token={TOKEN}".encode()),
        (403, {"origin": "http://elsewhere.example"}, b""),
        (403, {"origin": "null"}, b""),
        (403, {"origin": f"https://{OWN}"}, b""),
        (403, {"origin": f"http://{OWN}.elsewhere.example"}, b""),
        (403, {"origin": f"http://127.0.0.1:{PORT + 1}"}, b""),
        (403, {"origin": "http://elsewhere.example", "cookie": ""}, f"token={TOKEN}".encode()),
        (413, {"content-length": str(MOST + 1)}, b""),
        (413, {"content-length": "9" * 5000}, b""),
        (413, {"content-length": "-1"}, b""),
        (413, {"content-length": "1e3"}, b""),
    ],
)  # fmt: skip
def test_a_refusal_is_an_answer_and_nothing_reaches_the_application(expected, headers, query):
    sent, inner = ask(headers=headers, query=query)
    assert status(sent) == expected
    assert inner.seen == []
    assert TOKEN not in sent[1]["body"].decode()
    assert "set-cookie" not in headers_of(sent)
    assert headers_of(sent)["connection"] == "close"


def test_the_refusals_say_what_to_do():
    missing, _ = ask(headers={"cookie": ""})
    assert b"open the address that updyn serve printed" in missing[1]["body"]
    large, _ = ask(headers={"content-length": str(MOST + 1)})
    assert large[1]["body"] == b"At most 3 MB can be sent at once.\n"


def test_as_much_as_the_limit_passes():
    sent, inner = ask(headers={"content-length": str(MOST)}, chunks=(b"x" * MOST,))
    assert status(sent) == 200
    assert len(inner.seen[0]["body"]) == MOST


def test_a_body_without_its_length_is_cut_at_the_limit_and_answered():
    sent, inner = ask(chunks=(b"x" * MOST, b"y", b"z"))
    assert inner.seen == [{"type": "http", "body": b"left"}]
    assert status(sent) == 413
    assert sent[1]["body"] == b"At most 3 MB can be sent at once.\n"


@pytest.mark.parametrize(
    "cookies",
    [
        f"other=1; {COOKIE}; more=2",
        f'odd={{"a": 1}}; {COOKIE}',
        f"no value; {COOKIE}",
        f"caf\u00e9=\u00fc; {COOKIE}",
        f"a=b=c;{COOKIE}",
        f"[x]=1; {COOKIE}",
    ],
)
def test_cookies_of_other_programs_on_this_machine_do_not_lock_out(cookies):
    """Cookies do not tell ports apart: those of every local server come with each request."""
    sent, _ = ask(headers={"cookie": cookies})
    assert status(sent) == 200


# -- the secret in the address
def test_the_secret_in_the_address_becomes_a_cookie_and_leaves_the_address():
    sent, inner = ask(
        headers={"cookie": ""}, path="/run", query=f"token={TOKEN}&view=a%20b&view=c".encode()
    )
    assert status(sent) == 303
    assert inner.seen == []
    found = headers_of(sent)
    assert found["location"] == "/run?view=a+b&view=c"
    assert found["cache-control"] == "no-store"
    assert found["referrer-policy"] == "no-referrer"
    name, *attributes = found["set-cookie"].split("; ")
    assert name == COOKIE
    assert sorted(attributes) == ["HttpOnly", "Path=/", "SameSite=Strict"]


@pytest.mark.parametrize(
    ("path", "location"),
    [
        ("//elsewhere.example/x", "/elsewhere.example/x"),
        ("/\\elsewhere.example/x", "/%5Celsewhere.example/x"),
        ("/a\r\nset-cookie: x=1", "/a%0D%0Aset-cookie%3A%20x%3D1"),
        ("/\u03a9 mega", "/%CE%A9%20mega"),
        ("/a?b#c", "/a%3Fb%23c"),
    ],
)
def test_the_way_on_stays_on_this_server_whatever_the_path(path, location):
    sent, _ = ask(path=path, query=f"token={TOKEN}".encode())
    assert status(sent) == 303
    assert headers_of(sent)["location"] == location


def test_a_wrong_secret_in_the_address_is_not_made_good_by_the_cookie():
    sent, _ = ask(query=b"token=another")
    assert status(sent) == 401


# -- websockets
@pytest.mark.parametrize("origin", [f"http://{OWN}", f"http://localhost:{PORT}"])
def test_a_websocket_of_an_own_page_passes(origin):
    sent, inner = ask(kind="websocket", headers={"origin": origin})
    assert sent == []
    assert inner.seen == [{"type": "websocket", "body": b""}]


@pytest.mark.parametrize(
    ("headers", "query"),
    [
        ({}, b""),
        ({"origin": "http://elsewhere.example"}, b""),
        ({"origin": "null"}, b""),
        ({"origin": f"http://{OWN}", "host": f"elsewhere.example:{PORT}"}, b""),
        ({"origin": f"http://{OWN}", "cookie": ""}, b""),
        ({"origin": f"http://{OWN}", "cookie": ""}, f"token={TOKEN}".encode()),
    ],
)
def test_any_other_websocket_is_closed_before_it_is_open(headers, query):
    sent, inner = ask(kind="websocket", headers=headers, query=query)
    assert [m["type"] for m in sent] == ["websocket.close"]
    assert sent[0]["code"] == 1008
    assert inner.seen == []


def test_the_start_and_end_of_the_server_pass():
    sent, inner = ask(kind="lifespan", headers={"host": "", "cookie": ""})
    assert (sent, inner.seen) == ([], [{"type": "lifespan", "body": b""}])


# -- rules for browsers
SAFE = {
    "x-content-type-options": "nosniff",
    "referrer-policy": "no-referrer",
    "cross-origin-resource-policy": "same-origin",
}


@pytest.mark.parametrize(
    ("headers", "query"),
    [({}, b""), ({"cookie": ""}, b""), ({"host": "x"}, b""), ({"origin": "x"}, b""),
     ({"content-length": "x"}, b""), ({"cookie": ""}, f"token={TOKEN}".encode())],
)  # fmt: skip
def test_every_answer_has_the_rules(headers, query):
    sent, _ = ask(headers=headers, query=query)
    found = headers_of(sent)
    assert found.items() >= SAFE.items()
    assert "default-src" in found["content-security-policy"]
    assert "x;" not in found["content-security-policy"]  # nothing of what was asked


def test_the_policy_lets_nothing_in_from_elsewhere():
    sent, _ = ask(headers={"host": f"localhost:{PORT}"})
    policy = dict(
        part.strip().split(" ", 1)
        for part in headers_of(sent)["content-security-policy"].split(";")
    )
    allowed = {word for value in policy.values() for word in value.split()}
    local = {"'self'", "'none'", "'unsafe-inline'", "'unsafe-eval'", "data:", "blob:"}
    assert allowed - local == {f"ws://localhost:{PORT}"}
    assert (policy["object-src"], policy["frame-ancestors"]) == ("'none'", "'self'")


def test_a_stricter_policy_of_a_page_stays_the_only_one():
    own = (b"Content-Security-Policy", b"sandbox allow-scripts")
    sent, _ = ask(Inner([own]))
    policies = [v for k, v in sent[0]["headers"] if k.lower() == b"content-security-policy"]
    assert policies == [b"sandbox allow-scripts"]


# -- over a socket
@pytest.fixture
def served() -> Iterator[tuple[str, int]]:
    """A server with one page behind the guard, in a thread; its address and port."""
    app = FastAPI(docs_url=None, redoc_url=None, openapi_url=None)

    @app.post("/size")
    async def size(request: Request) -> int:
        return len(await request.body())

    listening = bind(0)
    port = listening.getsockname()[1]
    guard = Guard(app, port=port, token=TOKEN, most_bytes=1000)
    server = uvicorn.Server(
        uvicorn.Config(guard, log_level="critical", timeout_graceful_shutdown=1)
    )
    thread = threading.Thread(target=server.run, kwargs={"sockets": [listening]})
    thread.start()
    until = time.monotonic() + 30
    while not server.started and time.monotonic() < until:
        time.sleep(0.01)
    yield f"http://127.0.0.1:{port}", port
    server.should_exit = True
    thread.join()


def test_over_a_socket(served):
    address, port = served

    def chunks(count: int) -> Iterator[bytes]:
        for _ in range(count):
            yield b"x" * 100

    with httpx.Client(base_url=address, trust_env=False) as client:
        assert client.post("/size", content=b"abc").status_code == 401
        welcome = client.get("/size", params={"token": TOKEN})
        assert (welcome.status_code, welcome.headers["location"]) == (303, "/size")
        assert client.cookies[f"updyn-{port}"] == TOKEN
        assert client.post("/size", content=b"abc").json() == 3
        assert client.post("/size", content=chunks(10)).json() == 1000
        assert client.post("/size", content=b"x" * 1001).status_code == 413
        long = client.post("/size", content=chunks(11))
        assert (long.status_code, long.headers["x-content-type-options"]) == (413, "nosniff")
        assert client.post("/size", content=b"abc").json() == 3  # the server lives on
        foreign = {"host": f"elsewhere.example:{port}"}
        assert client.post("/size", content=b"", headers=foreign).status_code == 421
