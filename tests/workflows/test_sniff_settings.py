"""Lines that are named without settings."""

from __future__ import annotations

import os
import sys
from threading import Event, Thread
from typing import TYPE_CHECKING

import pytest

from mbtool.core import AutoLink, LinkError, SerialFormat, SerialLink, parse_link
from mbtool.modbus import ascii_adu, rtu_adu
from mbtool.workflows.sniff import with_settings
from tests.workflows.evidence import READ

if TYPE_CHECKING:
    from collections.abc import Iterator

pytestmark = pytest.mark.skipif(
    sys.platform == "win32", reason="pseudo-terminals need Linux or macOS"
)


@pytest.fixture
def pty() -> Iterator[tuple[int, str]]:
    near, far = os.openpty()
    yield near, os.ttyname(far)
    os.close(near)
    os.close(far)


@pytest.mark.parametrize("ascii_", [False, True])
def test_a_line_is_settled_and_it_is_said(pty: tuple[int, str], ascii_: bool) -> None:
    near, port = pty
    frame = (ascii_adu if ascii_ else rtu_adu)(1, READ)
    said: list[str] = []
    done = Event()

    def poll() -> None:
        while not done.wait(0.06):
            os.write(near, frame)

    master = Thread(target=poll)
    master.start()
    try:
        other = parse_link("tcp:127.0.0.1:1502")
        links = with_settings([other, AutoLink((port,))], said.append)
    finally:
        done.set()
        master.join()
    # On a pseudo-terminal every setting hears the same, so it is the first.
    assert links == [other, SerialLink(port, SerialFormat(), ascii_)]
    name = os.path.basename(port)
    assert said[0] == f"finding the settings of {name} by listening"
    assert said[1].startswith(f"{name}: 19200-8E1 {'ASCII' if ascii_ else 'RTU'}: ")
    assert said[1].endswith("sure; but for the parity, of whose errors this port tells nothing")


def test_a_port_that_is_not_there_is_said_like_any(pty: tuple[int, str]) -> None:
    with pytest.raises(LinkError, match="serial port /dev/tty-no: is not there"):
        with_settings([AutoLink(("/dev/tty-no",))], lambda _: None)
