"""mbtool demo."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mbtool.cli import exit_codes

if TYPE_CHECKING:
    from pathlib import Path

    from tests.cli.program import CommandLine


def test_shows_the_loop_and_keeps_the_log_that_is_asked_for(
    mbtool: CommandLine, tmp_path: Path
) -> None:
    path = tmp_path / "demo.mcap"
    told = mbtool("demo", "-w", path)
    assert told.code == exit_codes.DONE
    assert "0102H A/D conversion enable/disable setting: CH1 CH2 CH6 CH8 enabled" in told.out
    assert "! FT1A-Q16 limit is 100" in told.out
    assert told.lines[-1] == "22 of 22 answers agree with the devices' own."
    again = mbtool("decode", path)
    assert again.lines == told.lines[:-1]
