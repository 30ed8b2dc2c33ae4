"""``updyn serve`` as it begins and ends: messages for what cannot be served, the address, Ctrl-C."""

from __future__ import annotations

import errno
import importlib.util
import json
import os
import re
import signal
import socket
import subprocess
import sys
from pathlib import Path

import httpx
import pytest

from updyn.cli import main
from updyn.errors import InputError
from updyn.web.server import bind

#: The command line, with a job that is read once it is open, and a run that has just begun when
#: the server ends: what a user does by hand on the pages.
SERVED = """
import sys
from updyn.cli import main
from updyn.web import server

class Begun(server.Workspace):
    def open_job(self, name):
        super().open_job(name)
        self.view()

    def close(self):
        if not self.workers:
            self.begin("run", "out")
        super().close()

server.Workspace = Begun
raise SystemExit(main(["serve", sys.argv[1], "--no-open"]))
"""
JOB = """\
[model]
file = "chain.h5"
[test]
file = "chain.uff"
[[parameter]]
groups = "part*"
quantity = "stiffness"
[method]
name = "output-error"
[output]
report = false
"""


def refused(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> str:
    """Serve; return the one message that it ends with."""
    assert main(["serve", *arguments, "--no-open"]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith("error: ")
    assert err.count("error:") == 1
    assert "Traceback" not in err
    return err.removeprefix("error: ").rstrip("\n")


def test_a_port_in_use(chain_project: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with bind(0) as taken:
        port = taken.getsockname()[1]
        with pytest.raises(InputError, match=f"port {port} cannot be used"):
            bind(port)
        message = refused([str(chain_project / "job.toml"), "--port", str(port)], capsys)
    assert message == (
        f"port {port} cannot be used: {os.strerror(errno.EADDRINUSE)};"
        " choose another with --port, or leave it out"
    )


@pytest.mark.parametrize("port", [-1, 65536, 10**9])
def test_a_port_that_cannot_be(port: int) -> None:
    with pytest.raises(InputError, match=f"port {port} cannot be used"):
        bind(port)


def test_a_port_is_of_this_machine_alone_and_free_again() -> None:
    with bind(0) as found:
        host, port = found.getsockname()
        assert host == "127.0.0.1"
        with socket.create_connection((host, port)):
            pass
    with bind(port):
        pass


@pytest.mark.parametrize(
    ("content", "message"),
    [(b"title = '\xff'\n", "is not UTF-8; TOML is"), (None, "no such file; expected a job file (TOML)")],
)  # fmt: skip
def test_a_job_that_cannot_be_opened(
    tmp_path: Path, content: bytes | None, message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "bad.toml"
    if content is not None:
        path.write_bytes(content)
    assert refused([str(path)], capsys).endswith(f"bad.toml: {message}")


def test_a_job_that_is_a_folder(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert "no such file" in refused([str(tmp_path)], capsys)


def test_without_the_extra(
    chain_project: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    found = importlib.util.find_spec

    def without(name: str, package: str | None = None) -> object:
        return None if name == "nicegui" else found(name, package)

    monkeypatch.setattr("updyn.web.command.find_spec", without)
    message = refused([str(chain_project / "job.toml")], capsys)
    assert message == "updyn serve needs the extra 'app': pip install 'updyn[app]'"


@pytest.mark.skipif(os.name == "nt", reason="SIGINT to a group is another thing on Windows")
def test_the_address_and_ctrl_c_with_a_run_under_way(chain_project: Path) -> None:
    """A terminal sends Ctrl-C to every process of the job; the results are there afterwards."""
    (chain_project / "job.toml").write_text(JOB)
    process = subprocess.Popen(
        [sys.executable, "-c", SERVED, str(chain_project / "job.toml")],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        # A shell's background jobs, and so their children, are born deaf to Ctrl-C.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )
    try:
        assert process.stdout is not None
        address = process.stdout.readline().rstrip("\n")
        found = re.fullmatch(r"http://127\.0\.0\.1:(\d+)/\?token=([\w-]{43})", address)
        assert found is not None, address
        with httpx.Client(trust_env=False, timeout=60) as client:
            assert client.get(address.partition("?")[0]).status_code == 401
            page = client.get(address, follow_redirects=True)
        assert (page.status_code, page.url.path, page.url.query) == (200, "/", b"")
        assert found[2] not in page.text
        os.killpg(process.pid, signal.SIGINT)
        out, err = process.communicate(timeout=120)
    finally:
        if process.poll() is None:
            process.kill()
            process.wait()
    assert (process.returncode, out, err) == (130, "", "")
    written = json.loads((chain_project / "out" / "result.json").read_text())
    assert written["status"] == "stopped"
