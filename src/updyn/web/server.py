"""`serve`: the server of the pages, only for this machine."""

from __future__ import annotations

import secrets
import signal
import socket
import sys
import webbrowser
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager, contextmanager, suppress
from pathlib import Path

import uvicorn
from fastapi import FastAPI
from nicegui import ui

from updyn.errors import InputError
from updyn.web.guard import Guard
from updyn.web.pages import add_pages
from updyn.web.settings import WEB_CONNECTION, WEB_LIMIT
from updyn.web.workspace import Workspace

__all__ = ["bind", "serve"]

_HOST = "127.0.0.1"


def bind(port: int) -> socket.socket:
    """Return a listening socket on a port (0: any free one); InputError if it is not usable."""
    found = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    if sys.platform != "win32":  # there it would let two programs have one port
        found.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        found.bind((_HOST, port))
        found.listen()
    except (OSError, OverflowError) as error:
        found.close()
        reason = getattr(error, "strerror", None) or str(error).rstrip(".")
        raise InputError(
            f"port {port} cannot be used: {reason}; choose another with --port, or leave it out"
        ) from error
    return found


def serve(job: Path | None, folder: Path, *, port: int = 0, open_browser: bool = True) -> None:
    """Serve the pages of a project until the process is asked to end; InputError as `bind`."""
    workspace = Workspace(folder)
    if job is not None:
        workspace.open_job(job.resolve())
    listening = bind(port)
    port = listening.getsockname()[1]
    token = secrets.token_urlsafe(32)

    @asynccontextmanager
    async def lifespan(_app: FastAPI) -> AsyncIterator[None]:
        yield
        workspace.close()

    app = FastAPI(lifespan=lifespan, docs_url=None, redoc_url=None, openapi_url=None)
    add_pages(app, workspace)
    ui.run_with(
        app,
        title="updyn",
        dark=None,
        show_welcome_message=False,
        reconnect_timeout=WEB_CONNECTION.lost_after,  # pages have their own
    )
    most_bytes = workspace.most_upload + WEB_LIMIT.form_bytes
    guarded = Guard(app, port=port, token=token, most_bytes=most_bytes)
    config = uvicorn.Config(
        guarded,
        log_level="warning",
        lifespan="on",
        ws_max_size=WEB_LIMIT.message_bytes,
        timeout_graceful_shutdown=2,
    )
    address = f"http://{_HOST}:{port}/?token={token}"
    sys.stdout.write(f"{address}\n")
    sys.stdout.flush()
    if open_browser:
        webbrowser.open_new_tab(address)
    with _let_server_handle_signals():
        try:
            uvicorn.Server(config).run(sockets=[listening])
        finally:
            workspace.close()  # if the server ended before closing it


@contextmanager
def _let_server_handle_signals() -> Iterator[None]:
    """Let the server handle Ctrl-C, because it waits until a run has written its results.

    The command line handles signals, too, and would end the process meanwhile.
    """
    woken = signal.set_wakeup_fd(-1)
    try:
        with suppress(KeyboardInterrupt):
            yield
    finally:
        signal.set_wakeup_fd(woken)
