"""Who holds a port, told from the files of processes."""

from __future__ import annotations

import os
import shutil
import sys
from pathlib import Path

import pytest

from mbtool.core.local_ports import Holder
from mbtool.ports.local_ports import holders_of
from tests.sources.machine import Machine

if sys.platform != "linux":
    pytest.skip("processes' files are Linux's", allow_module_level=True)

PORT, OTHER = "/dev/ttyUSB0", "/dev/ttyUSB1"


@pytest.fixture
def machine(tmp_path: Path) -> Machine:
    return Machine(tmp_path)


def refuse_folders(monkeypatch: pytest.MonkeyPatch, *refused: Path) -> None:
    """Forbid folders: for root no mode does that."""
    listdir = os.listdir

    def listed(path: Path) -> list[str]:
        if path in refused:
            raise PermissionError(13, "Permission denied")
        return listdir(path)

    monkeypatch.setattr(os, "listdir", listed)


def test_each_holder_is_named_once_and_in_order(machine: Machine) -> None:
    machine.process(501, "picocom", "/dev/null", PORT, PORT)
    machine.process(77, "sniffer", PORT, OTHER, "socket:[1234]")
    machine.process(9, "bash", "/dev/pts/0")
    machine.write({"meminfo": "", "self/comm": "no number"}, below="proc")
    assert holders_of([PORT, OTHER], machine.root) == (
        {PORT: [Holder(77, "sniffer"), Holder(501, "picocom")], OTHER: [Holder(77, "sniffer")]},
        0,
    )


def test_processes_that_may_not_be_looked_into_are_counted(
    machine: Machine, monkeypatch: pytest.MonkeyPatch
) -> None:
    someone = machine.process(412, "agetty", PORT)
    kernel = machine.process(2, "kthreadd")
    (kernel / "cmdline").write_text("")
    machine.process(900, "picocom", PORT)
    refuse_folders(monkeypatch, someone / "fd", kernel / "fd")
    holders, unseen = holders_of([PORT], machine.root)
    assert holders == {PORT: [Holder(900, "picocom")]}
    assert unseen == 1


def test_a_process_that_ends_meanwhile_holds_nothing(machine: Machine) -> None:
    shutil.rmtree(machine.process(1, "ended") / "fd")
    nameless = machine.process(2, "ending", PORT)
    (nameless / "comm").unlink()
    assert holders_of([PORT], machine.root) == ({PORT: [Holder(2, "process")]}, 0)


def test_without_proc_nobody_is_seen(tmp_path: Path) -> None:
    assert holders_of([PORT], tmp_path) == ({PORT: []}, 0)


def test_this_very_process_is_found() -> None:
    near, far = os.openpty()
    try:
        name = os.ttyname(far)
        command = Path("/proc/self/comm").read_text().strip()
        assert Holder(os.getpid(), command) in holders_of([name], Path("/"))[0][name]
    finally:
        os.close(near)
        os.close(far)
