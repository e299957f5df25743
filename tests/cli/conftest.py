"""What every test of a command needs."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from tests.cli.program import CommandLine
from tests.workflows.evidence import capture_file

if TYPE_CHECKING:
    from pathlib import Path


@pytest.fixture
def mbtool(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> CommandLine:
    """Runs a command in this process."""
    return CommandLine(capsys, monkeypatch)


@pytest.fixture
def capture(tmp_path: Path) -> Path:
    """A capture of three reads."""
    path = tmp_path / "capture.pcap"
    path.write_bytes(capture_file(3))
    return path
