"""mbtool sniff --service and mbtool status."""

from __future__ import annotations

import json
import os
import signal
import socket
import sys
from pathlib import Path

import pytest

from mbtool.cli import exit_codes
from tests.cli.program import CommandLine, Program

CAPTURES = Path(__file__).resolve().parents[2] / "captures"
TAP = "tap:127.0.0.1:0=127.0.0.1:1"


@pytest.mark.skipif(sys.platform == "win32", reason="Unix sockets")
def test_a_service_tells_systemd_and_its_log_how_it_goes(
    tmp_path: Path, mbtool: CommandLine
) -> None:
    log, errors = tmp_path / "site.mcap", tmp_path / "errors"
    with (
        socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as channel,
        errors.open("w") as journal,
    ):
        channel.bind(str(tmp_path / "notify"))
        place = os.fstat(journal.fileno())
        environment = {
            "NOTIFY_SOCKET": str(tmp_path / "notify"),
            "WATCHDOG_USEC": "300000",
            "JOURNAL_STREAM": f"{place.st_dev}:{place.st_ino}",
        }
        command = ("sniff", TAP, "-w", log, "--rotate", "1h", "--service")
        with Program(*command, environment=environment, stderr=journal.fileno()) as program:
            assert channel.recv(1000) == b"READY=1\nSTATUS=recording; 0 transactions"
            while channel.recv(1000) != b"WATCHDOG=1":
                pass
            told = mbtool("status", log)
            assert told.code == exit_codes.DONE
            assert "state        recording" in told.lines
            assert program.end(signal.SIGTERM).out == ""
    assert errors.read_text().startswith("<6>listening on tap:127.0.0.1:")
    told = mbtool("status", log, "--json")
    assert json.loads(told.out)["state"] == "ended in order"
    assert json.loads(told.out)["heartbeat"]["bytes"] == 0


def test_a_service_without_a_log_in_parts_is_refused(mbtool: CommandLine, tmp_path: Path) -> None:
    for options in ([], ["-w", tmp_path / "x.mcap"]):
        told = mbtool("sniff", TAP, "--service", *options)
        assert told.code == exit_codes.USAGE
        assert "--service needs a log in parts" in told.err


def test_a_log_without_heartbeats_is_told_as_far_as_known(mbtool: CommandLine) -> None:
    told = mbtool("status", CAPTURES / "fa3-at1m8x-setup.mcap")
    assert told.code == exit_codes.DONE
    assert "state        ended in order" in told.lines
    assert "counters     none yet: only sniff --service writes them" in told.lines


def test_without_a_journal_lines_have_no_level(
    mbtool: CommandLine, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("JOURNAL_STREAM", "1:2")
    assert mbtool("status", "no-such.mcap").err.startswith("mbtool: no-such.mcap: ")
