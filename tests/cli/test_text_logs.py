"""Text logs as the input of commands."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

import pytest

from mbtool.cli import exit_codes
from tests.sources.text_logs import conversation, go_client, pymodbus

if TYPE_CHECKING:
    from pathlib import Path

    from tests.cli.program import CommandLine


@pytest.fixture
def log(tmp_path: Path) -> Path:
    path = tmp_path / "boiler.log"
    path.write_text(pymodbus(conversation()))
    return path


def test_statistics_of_a_log_with_times_have_rates(mbtool: CommandLine, log: Path) -> None:
    told = json.loads(mbtool("stats", log, "--json").out)
    assert told["transactions"] == 8
    (link,) = told["links"]
    assert link["link"] == "boiler"
    assert mbtool("stats", log).out.startswith("rtu boiler 19200-8E1, unit 1: 8 requests in 7.06 s")


@pytest.mark.parametrize("form", ["rtu", "tcp"])
@pytest.mark.parametrize("suffix", [".mcap", ".pcapng"])
def test_a_log_becomes_a_capture_with_the_same_transactions(
    mbtool: CommandLine, tmp_path: Path, form: str, suffix: str
) -> None:
    path, copy = tmp_path / "boiler.log", tmp_path / f"copy{suffix}"
    path.write_text(go_client(conversation(form)))
    assert mbtool("convert", path, copy).code == exit_codes.DONE
    told = [
        sorted((one["request_raw"], one["outcome"]) for one in map(json.loads, text.splitlines()))
        for text in (mbtool("decode", each, "--format", "jsonl").out for each in (path, copy))
    ]
    assert told[0] == told[1]
    assert len(told[0]) == 8


@pytest.mark.parametrize("command", ["check", "inventory", "report"])
def test_other_commands_take_a_log(
    mbtool: CommandLine, tmp_path: Path, log: Path, command: str
) -> None:
    more = ["-o", tmp_path / "page.html"] if command == "report" else []
    told = mbtool(command, log, *more)
    assert told.code in (exit_codes.DONE, exit_codes.NO)
    assert "15 frames in" in told.err


def test_a_text_without_frames_stops_no_other_file(
    mbtool: CommandLine, tmp_path: Path, log: Path
) -> None:
    long = tmp_path / "long.txt"
    long.write_text("the boiler house is warm\n" * 10_000)
    told = mbtool("decode", long, log)
    assert told.code == exit_codes.UNREADABLE
    assert "no answer" in told.out
    assert "not read: a text file of 10,000 lines, no capture; it shows no bytes" in told.err
