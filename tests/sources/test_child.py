"""Starting and ending the processes that keep time by themselves."""

from __future__ import annotations

import signal
import sys
from typing import TYPE_CHECKING

import pytest

from mbtool.core.serial_format import ModemLines
from mbtool.ports.serial_records import RecordKind, RecordReader
from mbtool.sources import child
from mbtool.sources.child import end_child, start_child

if TYPE_CHECKING:
    from pathlib import Path


def test_a_module_in_the_current_folder_does_not_get_in_the_way(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "serial.py").write_text("raise SystemExit('not this one')")
    monkeypatch.chdir(tmp_path)
    reader = start_child(
        "mbtool.sources.serial_reader", "/dev/tty-no", "9600-8N1", str(ModemLines())
    )
    assert reader.stdout is not None
    (record,) = RecordReader().feed(reader.stdout.read())
    assert record.kind is RecordKind.ERROR
    assert record.data.startswith(b"serial port /dev/tty-no: is not there")
    assert end_child(reader) == 0


@pytest.mark.skipif(sys.platform == "win32", reason="signals are of POSIX")
def test_a_child_that_does_not_end_is_killed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(child, "GRACE_S", 0.1)
    stubborn = start_child("http.server", "--bind", "127.0.0.1", "0")
    assert end_child(stubborn) == -signal.SIGKILL
