"""The input of a command is never its output, under whatever name."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING

import pytest

from mbtool.cli.output_path import demand_other_file
from mbtool.core import UsageError

if TYPE_CHECKING:
    from pathlib import Path


def test_a_file_that_is_standard_input_is_not_an_output(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "a.pcap"
    path.write_bytes(b"precious")
    descriptor = os.open(path, os.O_RDONLY)
    monkeypatch.setattr("mbtool.cli.output_path._STDIN", descriptor)
    demand_other_file(["-"], str(tmp_path / "b.csv"))
    demand_other_file(["-"], "-")
    with pytest.raises(UsageError, match="is an input and would be overwritten"):
        demand_other_file(["-"], str(path))
    os.close(descriptor)
    demand_other_file(["-"], str(path))
