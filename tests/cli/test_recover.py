"""mbtool recover."""

from __future__ import annotations

import gzip
from typing import TYPE_CHECKING

import pytest

from mbtool.cli import exit_codes
from mbtool.logs.layout import Opcode
from tests.logs.samples import changed, chunk, records_of, stock_messages, transaction, write_log

if TYPE_CHECKING:
    from pathlib import Path

    from tests.cli.program import CommandLine


@pytest.fixture
def log(tmp_path: Path) -> Path:
    return write_log(tmp_path / "x.mcap", [chunk(1), transaction(1), chunk(2), transaction(2)])


def test_a_whole_log_loses_nothing_and_the_exit_code_is_0(
    mbtool: CommandLine, log: Path, tmp_path: Path
) -> None:
    good = tmp_path / "good.mcap"
    told = mbtool("recover", log, "-o", good)
    assert (told.code, told.out) == (exit_codes.DONE, "")
    assert told.err == f"{good}: 3 messages of {log}; nothing is lost\n"
    assert stock_messages(good) == stock_messages(log)


def test_a_loss_is_a_line_and_the_exit_code_is_1(
    mbtool: CommandLine, log: Path, tmp_path: Path
) -> None:
    data = log.read_bytes()
    ((offset, size),) = records_of(data, Opcode.CHUNK)
    log.write_bytes(changed(data, offset + 9 + size - 20))
    told = mbtool("recover", log, "-o", tmp_path / "good.mcap")
    assert told.code == exit_codes.NO
    (line,) = told.lines
    assert line.startswith(
        f"lost: bytes {offset} to {offset + 9 + size} ({9 + size:,} bytes), "
        f"2023-11-14 22:13:20.001 to 2023-11-14 22:13:20.002 UTC: damaged at byte {offset}: a chunk"
    )
    assert told.err.endswith(
        f"0 messages of {log}; {9 + size:,} bytes in 1 place are lost, 3 messages\n"
    )


def test_damage_that_costs_nothing_is_said(mbtool: CommandLine, log: Path, tmp_path: Path) -> None:
    data = log.read_bytes()
    ((offset, _),) = records_of(data, Opcode.CHUNK)
    log.write_bytes(changed(data, offset + 3))
    told = mbtool("recover", log, "-o", tmp_path / "good.mcap")
    assert (told.code, told.out) == (exit_codes.DONE, "")
    assert told.err.startswith(
        f"mbtool: {log}: damaged at byte {offset}: the head of a record; nothing is lost there\n"
    )


def test_a_log_whose_first_bytes_are_damaged_is_recovered(
    mbtool: CommandLine, log: Path, tmp_path: Path
) -> None:
    log.write_bytes(changed(log.read_bytes(), 3))
    assert mbtool("decode", log).code == exit_codes.UNREADABLE
    told = mbtool("recover", log, "-o", tmp_path / "good.mcap")
    assert told.code == exit_codes.DONE
    assert len(stock_messages(tmp_path / "good.mcap")) == 3


def test_a_compressed_log_is_recovered(mbtool: CommandLine, log: Path, tmp_path: Path) -> None:
    packed = tmp_path / "x.mcap.gz"
    packed.write_bytes(gzip.compress(log.read_bytes()))
    assert mbtool("recover", packed, "-o", tmp_path / "good.mcap").code == exit_codes.DONE
    assert stock_messages(tmp_path / "good.mcap") == stock_messages(log)


def test_the_new_log_never_replaces_a_file_unasked(
    mbtool: CommandLine, log: Path, tmp_path: Path
) -> None:
    good = tmp_path / "good.mcap"
    good.write_bytes(b"precious")
    assert mbtool("recover", log, "-o", good).code == exit_codes.USAGE
    assert good.read_bytes() == b"precious"
    assert mbtool("recover", log, "-o", good, "--overwrite").code == exit_codes.DONE
    before = log.read_bytes()
    told = mbtool("recover", log, "-o", log, "--overwrite")
    assert (told.code, log.read_bytes()) == (exit_codes.USAGE, before)
    assert "the damaged log itself" in told.err


def test_what_is_no_log_is_told_in_one_line(
    mbtool: CommandLine, capture: Path, tmp_path: Path
) -> None:
    (tmp_path / "notes.txt").write_text("hello")
    for path in (capture, tmp_path / "notes.txt", tmp_path / "absent.mcap"):
        told = mbtool("recover", path, "-o", tmp_path / "good.mcap")
        assert (told.code, told.out) == (exit_codes.UNREADABLE, "")
        assert told.err.count("\n") == 1
    assert not (tmp_path / "good.mcap").exists()


def test_check_and_decode_tell_damage_in_the_summary(mbtool: CommandLine, log: Path) -> None:
    data = log.read_bytes()
    log.write_bytes(changed(data, len(data) - 60))
    for command in ("decode", "check"):
        told = mbtool(command, log)
        assert told.code == exit_codes.UNREADABLE
        assert "the summary, which repeats what is in the log; all else was read" in told.err
