from __future__ import annotations

import os
import signal
import stat
import subprocess
import sys
from pathlib import Path

import pytest

from mbtool.core import OutputError, UsageError
from mbtool.logs.creating import check_path, create_file
from mbtool.logs.reader import read_log
from mbtool.logs.rotation import RotatingLog, Rotation
from mbtool.logs.writer import LogWriter
from tests.logs.samples import chunk

needs_locks = pytest.mark.skipif(sys.platform == "win32", reason="needs flock")


def test_a_file_that_exists_is_not_overwritten(tmp_path: Path) -> None:
    path = tmp_path / "x.mcap"
    path.write_bytes(b"evidence")
    with pytest.raises(UsageError, match=r"the file exists, .* name another, .* --overwrite$"):
        create_file(path)
    assert path.read_bytes() == b"evidence"


def test_a_file_that_exists_is_replaced_on_request(tmp_path: Path) -> None:
    path = tmp_path / "x.mcap"
    path.write_bytes(b"old")
    create_file(path, replace=True).close()
    assert path.read_bytes() == b""


def test_a_file_that_cannot_be_created_is_the_users_mistake(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="cannot be created: there is no folder"):
        create_file(tmp_path / "absent" / "x.mcap")
    with pytest.raises(UsageError, match="cannot be created"):
        create_file(tmp_path / "a\0b")


@pytest.mark.parametrize("replace", [False, True])
def test_a_folder_is_an_error_that_says_so(tmp_path: Path, replace: bool) -> None:
    with pytest.raises(UsageError, match=r"a directory; name a file in it, for example .*x\.mcap"):
        create_file(tmp_path, replace=replace)


def test_a_path_can_be_checked_before(tmp_path: Path) -> None:
    check_path(tmp_path / "a.mcap")
    (tmp_path / "b.mcap").touch()
    check_path(tmp_path / "b.mcap", replace=True)
    with pytest.raises(UsageError, match="the file exists"):
        check_path(tmp_path / "b.mcap")
    with pytest.raises(UsageError, match="cannot be created: there is no folder"):
        check_path(tmp_path / "absent" / "a.mcap")
    assert [path.name for path in tmp_path.iterdir()] == ["b.mcap"]


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="needs pipes with names")
@pytest.mark.parametrize("replace", [False, True])
def test_a_pipe_is_refused_and_stays(tmp_path: Path, replace: bool) -> None:
    path = tmp_path / "x.mcap"
    os.mkfifo(path)
    with pytest.raises(UsageError, match="not a regular file; name another"):
        create_file(path, replace=replace)
    assert stat.S_ISFIFO(path.stat().st_mode)


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full here")
@pytest.mark.parametrize("replace", [False, True])
def test_a_device_is_refused_and_stays_through_a_link_too(tmp_path: Path, replace: bool) -> None:
    link = tmp_path / "x.mcap"
    link.symlink_to("/dev/full")
    for path in (Path("/dev/full"), link):
        with pytest.raises(UsageError, match=f"^{path}: not a regular file"):
            create_file(path, replace=replace)
    assert stat.S_ISCHR(Path("/dev/full").stat().st_mode)
    assert link.is_symlink()


def test_a_symbolic_link_is_followed_and_stays(tmp_path: Path) -> None:
    target, link = tmp_path / "target.mcap", tmp_path / "x.mcap"
    link.symlink_to(target)
    with LogWriter(link, capture={}) as log:
        log.write(chunk(1))
    assert list(read_log(target)) == [chunk(1)]
    with pytest.raises(UsageError, match=r"x\.mcap: the file exists"):
        create_file(link)
    with LogWriter(link, capture={}, replace=True) as log:
        log.write(chunk(2))
    assert list(read_log(target)) == [chunk(2)]
    assert link.is_symlink()


@needs_locks
def test_a_log_that_is_being_recorded_is_not_replaced(tmp_path: Path) -> None:
    path = tmp_path / "x.mcap"
    link = tmp_path / "y.mcap"
    link.symlink_to(path)
    first = LogWriter(path, capture={})
    for name in (path, link):
        with pytest.raises(OutputError, match=f"^{name}: another recorder is writing to it"):
            LogWriter(name, capture={}, replace=True)
    first.write(chunk())
    first.close()
    assert list(read_log(path)) == [chunk()]
    LogWriter(path, capture={}, replace=True).close()


@needs_locks
def test_the_first_part_of_a_log_is_not_replaced_while_later_ones_are_recorded(
    tmp_path: Path,
) -> None:
    with RotatingLog(tmp_path / "x.mcap", Rotation(size=1), capture={}) as log:
        path = log.path
        log.write(chunk(1))
        log.write(chunk(2))
        assert log.path != path
        with pytest.raises(OutputError, match="another recorder"):
            LogWriter(path, capture={}, replace=True)
    assert list(read_log(path)) == [chunk(1)]
    LogWriter(path, capture={}, replace=True).close()


@needs_locks
def test_a_recorder_that_is_killed_leaves_no_lock(tmp_path: Path) -> None:
    path = tmp_path / "x.mcap"
    program = [sys.executable, "-m", "tests.logs.killed_writer", str(path), "0.01"]
    root = Path(__file__).parents[2]
    with subprocess.Popen(program, stdout=subprocess.PIPE, cwd=root) as child:
        assert child.stdout is not None
        child.stdout.readline()
        with pytest.raises(OutputError, match="another recorder"):
            create_file(path, replace=True)
        assert path.stat().st_size > 0
        child.send_signal(signal.SIGKILL)
        child.wait(30)
    create_file(path, replace=True).close()


@needs_locks
def test_a_file_system_without_locks_takes_a_log(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(_descriptor: int, _operation: int) -> None:
        raise OSError(95, "Operation not supported")

    monkeypatch.setattr("fcntl.flock", refuse)
    create_file(tmp_path / "x.mcap").close()
    assert (tmp_path / "x.mcap").exists()
