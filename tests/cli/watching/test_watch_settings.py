"""What is remembered from run to run."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from mbtool.cli.watching.watch_settings import (
    MAX_FILTERS,
    WatchSettings,
    load_settings,
    save_settings,
    settings_path,
)

if TYPE_CHECKING:
    from pathlib import Path


def test_settings_are_read_back() -> None:
    settings = WatchSettings(columns={"polls": ["unit"]}, sorted_by={"polls": ("unit", True)})
    settings.note_filter("unit == 1")
    assert save_settings(settings) is None
    assert load_settings() == settings


@pytest.mark.parametrize("data", [b"", b"{", b'{"columns": 3}', b"\xff"])
def test_a_file_that_is_wrong_is_as_none(data: bytes) -> None:
    settings_path().parent.mkdir()
    settings_path().write_bytes(data)
    assert load_settings() == WatchSettings()


def test_a_folder_that_cannot_be_written_is_told(config_folder: Path) -> None:
    (config_folder / "mbtool").write_text("a file")
    assert load_settings() == WatchSettings()
    assert "not remembered" in (save_settings(WatchSettings()) or "")


def test_without_a_variable_the_folder_is_in_the_home(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("XDG_CONFIG_HOME", "relative")
    monkeypatch.setenv("HOME", str(tmp_path))
    assert settings_path() == tmp_path / ".config" / "mbtool" / "watch.json"


def test_filters_are_kept_once_each_the_newest_first() -> None:
    settings = WatchSettings()
    for number in range(MAX_FILTERS + 5):
        settings.note_filter(f"unit == {number}")
    settings.note_filter("unit == 20")
    assert settings.filters[:2] == ["unit == 20", f"unit == {MAX_FILTERS + 4}"]
    assert len(settings.filters) == MAX_FILTERS
    assert settings.filters.count("unit == 20") == 1
