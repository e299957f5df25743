"""mbtool replay --as-slave, with keys."""

from __future__ import annotations

import os
import select
import subprocess
import sys
import time
from typing import TYPE_CHECKING

import pytest

from mbtool.cli import exit_codes
from mbtool.core import TcpLink
from mbtool.master.links import open_master
from tests.cli.program import PATIENCE_S, CommandLine, endpoint_in
from tests.sources.live_helpers import MASTER_TIMEOUT_NS
from tests.workflows.evidence import READ, VALUES

if TYPE_CHECKING:
    from pathlib import Path

pytestmark = pytest.mark.skipif(
    sys.platform == "win32", reason="pseudo-terminals need Linux or macOS"
)

# The child makes the terminal its own: to fork beside the threads of other tests is not safe.
_PROGRAM = "import os; os.login_tty(0); from mbtool.cli.main import main; main()"


class Terminal:
    """A command at a terminal of its own, in its foreground."""

    def __init__(self, *arguments: object) -> None:
        self._near, far = os.openpty()
        self._child = subprocess.Popen(
            [sys.executable, "-c", _PROGRAM, *map(str, arguments)],
            stdin=far,
            stdout=far,
            stderr=far,
            env={**os.environ, "COLUMNS": "150"},
        )
        os.close(far)
        self.shown = ""

    def type(self, keys: str) -> None:
        os.write(self._near, keys.encode())

    def await_shown(self, word: str) -> str:
        """All that was shown up to now, once a word is in what is new of it."""
        new = ""
        deadline = time.monotonic() + PATIENCE_S
        while word not in new:
            rest_s = deadline - time.monotonic()
            assert rest_s > 0, f"no {word!r} in {new!r}"
            if select.select([self._near], [], [], rest_s)[0]:
                new += os.read(self._near, 4096).decode()
        self.shown += new
        return new

    def end(self) -> int:
        """Wait for the end, and give the exit code."""
        try:
            while os.read(self._near, 4096):
                pass
        except OSError:  # Linux says so when the other side has gone.
            pass
        os.close(self._near)
        return self._child.wait(PATIENCE_S)


def test_it_can_be_paused_and_ended_with_keys(capture: Path) -> None:
    terminal = Terminal(
        "replay", capture, "--as-slave", "--on", "tcp:127.0.0.1:0", "--match", "image"
    )
    said = terminal.await_shown("Ctrl-C ends")
    terminal.await_shown("waiting")
    with open_master(TcpLink(endpoint_in(said)), MASTER_TIMEOUT_NS) as master:
        assert master.ask(1, READ) == VALUES
    terminal.await_shown("playing")
    terminal.type(" ")
    terminal.await_shown("paused")
    terminal.type("+ ")
    terminal.await_shown("playing  0:0")
    terminal.await_shown("x2  1 asked")
    terminal.type("q")
    assert terminal.end() == exit_codes.INTERRUPTED


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["--match", "time", "--speed", "max"], "--match time goes by the recording's clock"),
        (["--loop", "--on-end", "last"], "--loop is --on-end loop; leave it out for --on-end last"),
        (["--start", "2", "--end", "1"], "--end 1: is not after --start 2"),
        (["--start", "nan"], "--start 'nan': write a time such as 2.5 (seconds)"),
        (["--start", "-1"], "--start '-1': write a time such as 2.5 (seconds)"),
        (["--end", "nan"], "--end 'nan': write a time such as 2.5 (seconds)"),
        (["--latency", "soon"], "--latency 'soon': write recorded, none, sampled"),
        (["--ignore", "HR1"], "--ignore goes with --as-master, not --as-slave"),
        (["--fault", "absent.toml"], "absent.toml"),
    ],
)
def test_wrong_usage_is_told(
    mbtool: CommandLine, capture: Path, arguments: list[str], says: str
) -> None:
    told = mbtool("replay", capture, "--as-slave", "--on", "tcp:127.0.0.1:0", *arguments)
    assert told.code in (exit_codes.USAGE, exit_codes.UNREADABLE)
    assert told.out == ""
    assert says in told.err


def test_options_of_another_side_are_refused(mbtool: CommandLine, capture: Path) -> None:
    told = mbtool("replay", capture, "--as-master", "--to", "tcp:127.0.0.1:1", "--match", "key")
    assert told.code == exit_codes.USAGE
    assert "--match goes with --as-slave, not --as-master" in told.err


def test_a_fault_that_the_link_cannot_show_is_refused(
    mbtool: CommandLine, capture: Path, tmp_path: Path
) -> None:
    path = tmp_path / "faults.toml"
    path.write_text('[[faults]]\nkind = "bad-crc"\n')
    told = mbtool("replay", capture, "--as-slave", "--on", "tcp:127.0.0.1:0", "--fault", path)
    assert told.code == exit_codes.USAGE
    assert "bad-crc on tcp:127.0.0.1:0: Modbus/TCP has no checksum" in told.err
