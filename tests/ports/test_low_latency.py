"""The settings of a driver that delay bytes, while a port is open and afterwards."""

from __future__ import annotations

import os
import sys
from typing import TYPE_CHECKING

import pytest

from mbtool.ports.low_latency import LowLatency

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="settings of Linux")


@pytest.fixture
def descriptor() -> Iterator[int]:
    """A descriptor that takes no settings of a serial port."""
    with open(os.devnull, "rb") as file:
        yield file.fileno()


def trigger(root: Path, name: str, text: str) -> Path:
    file = root / "sys/class/tty" / name / "rx_trig_bytes"
    file.parent.mkdir(parents=True)
    file.write_text(text)
    return file


def test_a_fifo_hands_over_each_byte_while_the_port_is_open(
    tmp_path: Path, descriptor: int
) -> None:
    file = trigger(tmp_path, "ttyS1", "8\n")
    settings = LowLatency(descriptor, "/dev/ttyS1", tmp_path)
    assert file.read_text() == "1"
    settings.restore()
    assert file.read_text() == "8"


def test_a_fifo_that_did_so_before_is_left_alone(tmp_path: Path, descriptor: int) -> None:
    file = trigger(tmp_path, "ttyS1", "1\n")
    LowLatency(descriptor, "/dev/ttyS1", tmp_path).restore()
    assert file.read_text() == "1\n"


def test_a_port_without_these_settings_is_no_error(tmp_path: Path, descriptor: int) -> None:
    LowLatency(descriptor, "/dev/ttyUSB0", tmp_path).restore()
    trigger(tmp_path, "ttyS1", "\xff").chmod(0o444)
    LowLatency(descriptor, "/dev/ttyS1", tmp_path).restore()
