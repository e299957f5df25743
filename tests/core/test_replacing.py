"""Replacing a file in one step."""

from __future__ import annotations

import os
import sys
from typing import TYPE_CHECKING

import pytest

from mbtool.core import UsageError
from mbtool.core.replacing import replacing

if TYPE_CHECKING:
    from pathlib import Path


@pytest.fixture
def old(tmp_path: Path) -> Path:
    path = tmp_path / "old.csv"
    path.write_text("older")
    path.chmod(0o640)
    return path


def test_what_a_killed_run_of_the_same_process_id_left_is_removed(old: Path) -> None:
    left = old.with_name(f".{old.name}.{os.getpid()}.part")
    left.write_text("left by a killed run")
    with replacing(old) as beside:
        assert beside == left
        assert beside.read_bytes() == b""
        beside.write_text("new")
    assert old.read_text() == "new"
    assert [*old.parent.iterdir()] == [old]


@pytest.mark.skipif(sys.platform == "win32", reason="has no such rights")
def test_only_the_owner_can_read_the_new_file_until_it_is_whole(old: Path) -> None:
    with replacing(old) as beside:
        assert beside.stat().st_mode & 0o777 == 0o600
        beside.write_text("new")
    assert old.stat().st_mode & 0o777 == 0o640


def test_a_folder_that_cannot_be_written_is_told_by_the_path_of_the_user(
    old: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refused(*_: object, **__: object) -> int:
        raise PermissionError(13, "Permission denied", f".{old.name}.part")

    monkeypatch.setattr(os, "open", refused)
    with pytest.raises(UsageError) as told, replacing(old):
        pass
    assert str(told.value) == f"{old}: cannot be replaced: its folder cannot be written"


@pytest.mark.skipif(sys.platform == "win32", reason="has other limits")
def test_a_name_too_long_for_a_second_file_is_told(tmp_path: Path) -> None:
    path = tmp_path / ("a" * 250)
    path.write_text("older")
    told = r"a: cannot be replaced: File name too long$"
    with pytest.raises(UsageError, match=told), replacing(path):
        pass
    assert path.read_text() == "older"
