"""What is remembered from run to run."""

from __future__ import annotations

import errno
import os
from pathlib import Path

import pytest

from mbtool.cli.watching.drawn_app import (
    MAX_FILTERS,
    WatchSettings,
    load_settings,
    save_settings,
    settings_path,
)


def write(data: bytes) -> Path:
    path = settings_path()
    path.parent.mkdir()
    path.write_bytes(data)
    return path


def test_settings_are_read_back() -> None:
    settings = WatchSettings(columns={"polls": ["unit"]}, sorted_by={"polls": ("unit", True)})
    settings.note_filter("unit == 1")
    assert save_settings(settings) is None
    assert load_settings() == (settings, None)
    assert [one.name for one in settings_path().parent.iterdir()] == ["watch.json"]


def test_without_a_file_all_is_as_usual_and_nothing_is_told() -> None:
    assert load_settings() == (WatchSettings(), None)


@pytest.mark.parametrize(
    ("data", "reason"),
    [
        (b"", "Input data was truncated"),
        (b'{"columns": 3}', "Expected `object`, got `int` - at `$.columns`"),
        (b"\xff", "JSON is malformed: invalid character (byte 0)"),
        (b'{"filters": ["\xff"]}', "not UTF-8"),
    ],
)
def test_a_damaged_file_is_told_and_kept_beside_the_new_one(data: bytes, reason: str) -> None:
    path = write(data)
    settings, told = load_settings()
    assert settings == WatchSettings()
    assert told is not None
    assert told.startswith(f"{path}: damaged: {reason}")
    assert told.endswith("; columns, sorting and filters are the usual ones")
    kept = path.with_name("watch.json.damaged")
    assert path.read_bytes() == data
    settings.note_filter("unit == 1")
    assert save_settings(settings) is None
    assert (load_settings(), kept.read_bytes()) == ((settings, None), data)


def test_a_file_that_cannot_be_read_is_told_and_kept() -> None:
    path = settings_path()
    path.mkdir(parents=True)
    _, told = load_settings()
    assert told == (
        f"{path}: cannot be read: Is a directory; columns, sorting and filters are the usual ones"
    )
    assert save_settings(WatchSettings()) is None
    assert path.with_name("watch.json.damaged").is_dir()


def test_a_file_in_place_of_the_folder_is_told(config_folder: Path) -> None:
    folder = config_folder / "mbtool"
    folder.write_text("a file")
    assert load_settings() == (WatchSettings(), None)
    assert save_settings(WatchSettings()) == (
        f"columns, sorting and filters are not remembered: {folder} is a file, not a folder"
    )


def test_a_folder_that_cannot_be_written_is_told_in_words(monkeypatch: pytest.MonkeyPatch) -> None:
    path = write(b"{}")

    def refuse(*_: object) -> None:
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), path)

    monkeypatch.setattr(Path, "write_bytes", refuse)
    assert save_settings(WatchSettings()) == (
        "columns, sorting and filters are not remembered: "
        f"{path.parent} cannot be written: Permission denied"
    )


def test_without_a_home_folder_nothing_is_remembered(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail() -> Path:
        raise RuntimeError("Could not determine home directory.")

    monkeypatch.delenv("XDG_CONFIG_HOME")
    monkeypatch.setattr(Path, "home", fail)
    assert load_settings() == (WatchSettings(), None)
    assert save_settings(WatchSettings()) == (
        "columns, sorting and filters are not remembered: there is no home folder"
    )


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
