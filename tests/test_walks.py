"""The walks that docs/architecture.md tells are those that a trace shows."""

from __future__ import annotations

import re
import socket
import sys
import threading
from collections import Counter
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from typer.main import get_command

import mbtool
from mbtool.cli.main import app
from mbtool.core import Packet, parse_link
from mbtool.decode.decoder import Decoder
from mbtool.devices import Assignments, Namer, load_profile
from mbtool.logs.opening import create_log
from mbtool.modbus import mbap_adu
from mbtool.packets import read_capture
from mbtool.sources.inbox import Ended, Inbox
from mbtool.workflows.slave import device_slave
from mbtool.workflows.sniff import Sniffer

if TYPE_CHECKING:
    from collections.abc import Callable
    from types import FrameType

SOURCE = Path(mbtool.__file__).parent
ROOT = Path(__file__).resolve().parents[1]
PAGE = (ROOT / "docs" / "architecture.md").read_text()
CAPTURE = ROOT / "captures" / "fa3-at1m8x-setup.pcap"

READ = bytes.fromhex("03 0000 0002")
LINE = bytes.fromhex("01 03 0000 0002 C40B01 03 04 0001 0002 2A32")

Hop = tuple[str, str]
"""A file of mbtool/ and the name of a function in it."""


def hops(heading: str) -> list[Hop]:
    """The rows of the table below a heading."""
    section = PAGE.split(f"### {heading}\n", 1)[1].split("\n#", 1)[0]
    return re.findall(r"^\| `([\w/]+\.py)` \| `([\w.]+)` \|", section, re.MULTILINE)


def called(run: Callable[[], object]) -> Counter[Hop]:
    """How often the functions of mbtool are called, in the order of their first calls."""
    found: Counter[Hop] = Counter()

    def note(frame: FrameType, event: str, _argument: object) -> None:
        file = Path(frame.f_code.co_filename)
        if event == "call" and file.is_relative_to(SOURCE):
            found[str(file.relative_to(SOURCE)), frame.f_code.co_qualname] += 1

    before = sys.getprofile()
    threading.setprofile(note)
    sys.setprofile(note)
    try:
        run()
    finally:
        sys.setprofile(before)
        threading.setprofile(None)
    return found


class OnePacketSource:
    """A source in the place of a network interface: puts the packets of a capture."""

    link = place = "eth0"
    discarded_packets = 0

    def __init__(self, inbox: Inbox) -> None:
        self._inbox = inbox

    def __enter__(self) -> OnePacketSource:
        with CAPTURE.open("rb") as file:
            for packet in read_capture(file, CAPTURE.name):
                assert isinstance(packet, Packet)
                self._inbox.put(packet)
        self._inbox.put(Ended(self.link))
        return self

    def __exit__(self, *_: object) -> None: ...

    def accept(self) -> None: ...

    def close(self) -> None: ...


def decode_a_line(folder: Path) -> None:
    file = folder / "line.bin"
    file.write_bytes(LINE * 2)
    arguments = ["decode", str(file), "--link", "rtu@19200-8E1"]
    get_command(app).main(arguments, standalone_mode=False)


def sniff_packets(folder: Path) -> None:
    link = parse_link("net:eth0")
    begin = partial(create_log, str(folder / "a.mcap"), [link], Assignments())
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            "mbtool.workflows.sniff.live_source", lambda _link, inbox, **_: OnePacketSource(inbox)
        )
        with Sniffer([link], Decoder(Namer(), ports=[502]), begin_log=begin) as sniffer:
            assert list(sniffer.records(lambda _now_ns: False))


def ask_a_slave(_folder: Path, times: int = 1) -> None:
    shell = device_slave(load_profile("idec-ft1a-touch"), parse_link("tcp:127.0.0.1:0"), 1)
    with shell:
        _, _, port = shell.place.rpartition(":")
        with socket.create_connection(("127.0.0.1", int(port)), timeout=60) as master:
            for _ in range(times):
                master.sendall(mbap_adu(1, 1, READ))
                assert master.recv(100)


@pytest.mark.parametrize(
    ("heading", "run"),
    [
        ("A byte on an RS-485 line, to its row", decode_a_line),
        ("A packet on a network, to the log", sniff_packets),
        ("A request to a slave, to its response", ask_a_slave),
    ],
)
def test_a_walk_of_the_docs_is_what_a_trace_shows(
    heading: str, run: Callable[[Path], None], tmp_path: Path
) -> None:
    told = hops(heading)
    assert len(told) >= 8
    traced = called(lambda: run(tmp_path))
    assert [hop for hop in traced if hop in told] == told


def test_a_read_that_a_slave_was_asked_before_takes_eight_calls_in_four_modules() -> None:
    calls = called(lambda: ask_a_slave(Path(), times=50))
    of_each = [hop for hop, count in calls.items() if count >= 49]
    assert len(of_each) <= 8, of_each
    assert len({file for file, _ in of_each}) <= 4
