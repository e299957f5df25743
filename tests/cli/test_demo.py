"""mbtool demo."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mbtool.cli import exit_codes

if TYPE_CHECKING:
    from pathlib import Path

    import pytest

    from tests.cli.program import CommandLine


def test_shows_the_loop_and_keeps_the_log_that_is_asked_for(
    mbtool: CommandLine, tmp_path: Path
) -> None:
    for number in range(5):  # A busy machine may lose a request: see tests/workflows/test_demo.py.
        path = tmp_path / f"{number}.mcap"
        told = mbtool("demo", "-w", path)
        if "does not answer" not in told.err:
            break
    assert told.code == exit_codes.DONE
    assert "0102H A/D conversion enable/disable setting: CH1 CH2 CH6 CH8 enabled" in told.out
    assert "! FT1A-Q16 limit is 100" in told.out
    assert told.lines[-1] == "22 of 22 answers agree with the devices' own."
    again = mbtool("decode", path)
    assert again.lines == told.lines[:-1]


def test_a_log_that_is_there_is_told_before_anything_begins(
    mbtool: CommandLine, tmp_path: Path
) -> None:
    path = tmp_path / "first.mcap"
    path.write_text("older")
    told = mbtool("demo", "-w", path)
    assert (told.code, told.out) == (exit_codes.USAGE, "")
    assert told.err == (
        f"mbtool: {path}: the file exists, and a recording is not overwritten; name another, "
        "remove it, or replace it with --overwrite\n"
    )
    assert path.read_text() == "older"


def test_a_log_that_cannot_be_created_is_told_before_anything_begins(
    mbtool: CommandLine, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("os.access", lambda *_: False)  # The superuser may write anywhere.
    path = tmp_path / "first.mcap"
    told = mbtool("demo", "-w", path)
    assert (told.code, told.out) == (exit_codes.USAGE, "")
    assert told.err == f"mbtool: {path}: cannot be created: Permission denied\n"
