"""What a device keeps over a restart, in a file."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from mbtool.core import InputError, UsageError
from mbtool.devices import load_profile
from mbtool.modbus import Table
from mbtool.slave.device.image import RegisterImage
from mbtool.slave.families import make_device
from mbtool.slave.shells.state_file import keep_state

if TYPE_CHECKING:
    from mbtool.slave.device.responder import DeviceResponder

PROFILE = load_profile("fa3-at1m8x")
SET_SPLIT = bytes.fromhex("06 00F5 0005")
AT_FIRST = [0x03FA, 0xC0A8, 600, 10, 3, 30]


def _device(state: Path, troubles: list[str] | None = None) -> DeviceResponder:
    device = make_device(PROFILE, RegisterImage.of(PROFILE))
    keep_state(state, PROFILE, device, ([] if troubles is None else troubles).append)
    return device


def _kept(device: DeviceResponder) -> list[int]:
    return device.image.get(Table.HOLDING_REGISTERS, 0x00F0, 6)


def test_the_timers_outlast_a_restart(tmp_path: Path) -> None:
    state = tmp_path / "state.toml"
    first = _device(state)
    assert _kept(first) == AT_FIRST
    first.respond(0, SET_SPLIT, 0)
    assert _kept(_device(state)) == [*AT_FIRST[:5], 5]
    assert "00F5H = 5\n" in state.read_text()


def test_what_is_not_kept_starts_afresh(tmp_path: Path) -> None:
    state = tmp_path / "state.toml"
    first = _device(state)
    first.respond(0, bytes.fromhex("06 0102 00FF"), 0)
    first.respond(0, SET_SPLIT, 0)
    assert _device(state).image.get(Table.HOLDING_REGISTERS, 0x0102) == [0]


def test_the_file_is_whole_at_any_moment(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    state = tmp_path / "state.toml"
    device = _device(state)
    seen: list[str] = []
    replace, sync = os.replace, os.fsync

    def looked_replace(source: Path, target: Path) -> None:
        seen.append("replace")
        assert "00F5H = 30\n" in target.read_text()
        assert "00F5H = 5\n" in source.read_text()
        assert source.parent == target.parent
        replace(source, target)

    def looked_sync(descriptor: int) -> None:
        seen.append("sync")
        sync(descriptor)

    monkeypatch.setattr(os, "replace", looked_replace)
    monkeypatch.setattr(os, "fsync", looked_sync)
    device.respond(0, SET_SPLIT, 0)
    assert seen[:2] == ["sync", "replace"]
    assert [path.name for path in tmp_path.iterdir()] == ["state.toml"]


def test_what_a_crash_left_beside_the_file_is_taken_over(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    state = tmp_path / "state.toml"
    device = _device(state)

    def crash(*_: object) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as crashing:
        crashing.setattr(os, "replace", crash)
        with pytest.raises(KeyboardInterrupt):
            device.respond(0, SET_SPLIT, 0)
    assert len(list(tmp_path.iterdir())) == 2
    monkeypatch.setattr(os, "getpid", lambda: -1)  # Another process, after the crash.
    assert _kept(_device(state)) == AT_FIRST
    assert [path.name for path in tmp_path.iterdir()] == ["state.toml"]


def test_a_disk_that_is_full_later_is_told_and_the_old_state_stays(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    state = tmp_path / "state.toml"
    troubles: list[str] = []
    device = _device(state, troubles)

    def fail(_: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", fail)
    answer = device.respond(0, SET_SPLIT, 0)
    assert answer is not None
    assert answer.pdu == SET_SPLIT
    assert troubles == [f"{state}: not written: No space left on device; its state is not kept"]
    assert "00F5H = 30\n" in state.read_text()
    assert [path.name for path in tmp_path.iterdir()] == ["state.toml"]


def test_a_folder_that_is_not_there_is_told_at_once(tmp_path: Path) -> None:
    with pytest.raises(
        UsageError, match=r"absent/state\.toml: cannot be written: there is no folder"
    ):
        _device(tmp_path / "absent" / "state.toml")


def test_a_file_of_start_values_is_not_taken_for_a_state(tmp_path: Path) -> None:
    state = tmp_path / "start.toml"
    state.write_text("0102H = 92\n")
    says = "0102H: fa3-at1m8x does not keep this over a restart; is this a file of start values"
    with pytest.raises(UsageError, match=re.escape(says)):
        _device(state)
    assert state.read_text() == "0102H = 92\n"


def test_a_file_that_is_no_state_stays_as_it_is(tmp_path: Path) -> None:
    state = tmp_path / "photo.toml"
    state.write_text("not toml")
    with pytest.raises(UsageError, match="not TOML"):
        _device(state)
    assert state.read_text() == "not toml"


@pytest.mark.parametrize("name", ["/dev/full", "."])
def test_what_is_no_file_is_not_taken_for_a_state(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    monkeypatch.chdir(tmp_path)
    if not Path(name).exists():
        pytest.skip(f"no {name} here")
    with pytest.raises(UsageError, match="is no file; --state wants one"):
        _device(Path(name))


def test_a_device_that_keeps_nothing_has_no_state(tmp_path: Path) -> None:
    touch = load_profile("idec-ft1a-touch")
    device = make_device(touch, RegisterImage.of(touch))
    with pytest.raises(UsageError, match="idec-ft1a-touch keeps nothing over a restart"):
        keep_state(tmp_path / "state.toml", touch, device, print)
    assert list(tmp_path.iterdir()) == []


def test_links_in_a_circle_are_told(tmp_path: Path) -> None:
    state = tmp_path / "state.toml"
    state.symlink_to(state)
    with pytest.raises(InputError, match=r"cannot be read: .*[Ll]oop"):
        _device(state)


def test_a_link_to_a_state_stays_a_link(tmp_path: Path) -> None:
    state, link = tmp_path / "state.toml", tmp_path / "link.toml"
    link.symlink_to(state)
    _device(link).respond(0, SET_SPLIT, 0)
    assert link.is_symlink()
    assert "00F5H = 5\n" in state.read_text()


def test_a_second_process_is_refused_a_state_that_a_slave_keeps(tmp_path: Path) -> None:
    state = tmp_path / "state.toml"
    _device(state)
    before = state.read_bytes()
    program = (
        "import sys, pathlib; from tests.slave.shells.test_state_file import _device\n"
        "try: _device(pathlib.Path(sys.argv[1]))\n"
        "except Exception as error: print(type(error).__name__, error)"
    )
    told = subprocess.run(
        [sys.executable, "-c", program, str(state)], capture_output=True, text=True, check=True
    ).stdout
    assert told == (
        f"UsageError {state}: another slave keeps its state there; name another file, or end that "
        "one first\n"
    )
    assert state.read_bytes() == before
    assert _kept(_device(state)) == AT_FIRST  # The same process may.
