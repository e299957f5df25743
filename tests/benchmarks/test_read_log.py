"""The measurement of reading logs, on a small log."""

from __future__ import annotations

from typing import TYPE_CHECKING

from tests.benchmarks.read_log import main, measured, write_polling

if TYPE_CHECKING:
    from pathlib import Path

    import pytest


def test_every_reader_reads_what_it_should(tmp_path: Path) -> None:
    write_polling(tmp_path / "x.mcap", 20)
    found = measured(tmp_path / "x.mcap", rounds=1)
    assert [count for count, _ in found.values()] == [60, 20, 20, 20, 20, 40, 60]


def test_the_figures_are_printed(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--transactions", "5", "--rounds", "1"]) == 0
    assert "mbtool, transactions in lists" in capsys.readouterr().out
