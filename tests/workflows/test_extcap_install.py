"""The scripts by which Wireshark finds mbtool."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from mbtool.core import UsageError
from mbtool.workflows.extcap_install import install, scripts, uninstall


def _paths(home: Path) -> list[Path]:
    return scripts({"HOME": str(home)}, "linux")


def test_there_is_a_script_for_each_version_of_wireshark(tmp_path: Path) -> None:
    assert _paths(tmp_path) == [
        tmp_path / ".config/wireshark/extcap/mbtool-extcap",
        tmp_path / ".local/lib/wireshark/extcap/mbtool-extcap",
    ]
    moved = scripts({"HOME": "/h", "XDG_CONFIG_HOME": "/c"}, "linux")
    assert moved[0] == Path("/c/wireshark/extcap/mbtool-extcap")
    (batch,) = scripts({"APPDATA": "/a"}, "win32")
    assert batch == Path("/a/Wireshark/extcap/mbtool-extcap.bat")
    for platform in ("linux", "win32"):
        with pytest.raises(UsageError, match="is not set"):
            scripts({}, platform)


@pytest.mark.skipif(sys.platform == "win32", reason="runs a shell script")
def test_a_script_runs_this_program(tmp_path: Path) -> None:
    install(_paths(tmp_path))
    for path in _paths(tmp_path):
        command = [str(path), "--extcap-interfaces", "--extcap-version=4.0"]
        done = subprocess.run(command, capture_output=True, text=True, check=True, env=os.environ)
        assert "interface {value=mbtool}" in done.stdout


def test_what_was_installed_is_removed_and_nothing_else(tmp_path: Path) -> None:
    paths = _paths(tmp_path)
    beside = paths[0].with_name("other")
    install(paths)
    install(paths)
    beside.write_text("not ours")
    assert uninstall(paths) == paths
    assert uninstall(paths) == []
    assert [path for path in tmp_path.rglob("*") if path.is_file()] == [beside]


def test_the_program_of_somebody_else_is_left_alone(tmp_path: Path) -> None:
    paths = _paths(tmp_path)
    paths[1].parent.mkdir(parents=True)
    paths[1].write_text("theirs")
    for action in (install, uninstall):
        with pytest.raises(UsageError, match="was not made by mbtool"):
            action(paths)
    assert paths[1].read_text() == "theirs"
    assert not paths[0].exists()


def test_a_folder_that_cannot_be_made_is_named(tmp_path: Path) -> None:
    (tmp_path / ".config").write_text("a file")
    with pytest.raises(UsageError, match="cannot be written"):
        install(_paths(tmp_path))


def test_a_batch_file_runs_this_program(tmp_path: Path) -> None:
    paths = scripts({"APPDATA": str(tmp_path)}, "win32")
    install(paths, "C:\\Python\\python.exe")
    assert '"C:\\Python\\python.exe" -m mbtool extcap %*' in paths[0].read_text()
