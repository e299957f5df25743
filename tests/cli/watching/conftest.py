"""The user's config folder of these tests."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from mbtool.views import trouble_lines

if TYPE_CHECKING:
    from pathlib import Path


@pytest.fixture(autouse=True)
def config_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path))
    monkeypatch.delenv("NO_COLOR", raising=False)
    return tmp_path


@pytest.fixture
def _one_line_of_troubles(monkeypatch: pytest.MonkeyPatch) -> None:
    """For tests that count the lines of the screen from above."""
    monkeypatch.setattr(trouble_lines, "WATCH_LINES", 1)
