"""A serial line as a live interface of tshark: each frame with its direction, while it is heard."""

from __future__ import annotations

import shutil
import sys
from itertools import cycle, islice
from typing import TYPE_CHECKING

import pytest

from mbtool.core import SerialLink
from mbtool.master.links import open_master
from mbtool.modbus import Response, rtu_adu
from mbtool.slave.shells import SerialSlave
from mbtool.sources.virtual_line import VirtualLine
from mbtool.workflows.extcap_install import install, scripts
from tests.end_to_end.programs import Program
from tests.slave.scripted import Scripted
from tests.workflows.bench import FAST

if TYPE_CHECKING:
    from pathlib import Path

pytestmark = [
    pytest.mark.peers,
    pytest.mark.skipif(shutil.which("tshark") is None, reason="needs tshark"),
    pytest.mark.skipif(sys.platform == "win32", reason="needs pseudo-terminals"),
]

MAX_DOUBTFUL = 2
COUNT = 100
"""Transactions; each is two frames."""
PAUSE_NS = 20_000_000
"""Between two transactions, as masters have it; on a busy machine shorter ones may not be heard."""
ANSWER_NS = 5_000_000_000
WARM_UP = bytes.fromhex("03 7000 0001")
LAST = bytes.fromhex("04 7FFF 0001")
KINDS = {
    bytes.fromhex(request): bytes.fromhex(response)
    for request, response in (
        ("03 0000 0002", "03 04 1234 5678"),
        ("06 0010 0007", "06 0010 0007"),
        ("01 0003 000A", "01 02 CD 01"),
        ("05 0003 FF00", "05 0003 FF00"),
        ("10 0001 0002 04 000A 0102", "10 0001 0002"),
        ("03 1000 0001", "83 02"),
        ("16 0004 00F2 0025", "16 0004 00F2 0025"),
        ("17 0003 0001 000E 0001 02 00FF", "17 02 00FE"),
        ("02 00C4 0016", "02 03 ACDB35"),
        ("04 0008 0001", "04 02 000A"),
    )
}


def test_200_live_frames_have_the_right_direction(tmp_path: Path) -> None:
    home, pcapng = tmp_path / "home", tmp_path / "live.pcapng"
    home.mkdir()
    install(scripts({"HOME": str(home)}))
    one_register = Response(bytes.fromhex("03 02 0001")), Response(bytes.fromhex("04 02 0001"))
    answers = {pdu: Response(answer) for pdu, answer in KINDS.items()}
    answers |= {WARM_UP: one_register[0], LAST: one_register[1]}
    sequence = list(islice(cycle(KINDS), COUNT))
    with VirtualLine(ends=3, format=FAST) as line:
        ear, slave, master = line.ports
        settings = {"path": ear, "port": "none", "baud": "115200", "format": "8N1"}
        chosen = [f"extcap.mbtool.{name}:{value}" for name, value in settings.items()]
        tshark = Program(
            "env", f"HOME={home}", "tshark", "-i", "mbtool", "-l", "-w", str(pcapng), "-P",
            *(part for one in chosen for part in ("-o", one)),
            "-T", "fields", "-e", "udp.srcport", "-e", "udp.payload",
        )  # fmt: skip
        script = Scripted(lambda _unit, pdu: answers[pdu])
        with (
            tshark,
            SerialSlave(SerialLink(slave, FAST), script),
            open_master(SerialLink(master, FAST), ANSWER_NS) as link,
        ):
            while not tshark.printed.text:
                assert tshark.process.poll() is None, tshark.said.text
                link.ask(1, WARM_UP)
            for pdu in sequence:
                link.receive(PAUSE_NS)
                assert link.ask(1, pdu) == KINDS[pdu], script.asked[-1]
            link.ask(1, LAST)
            tshark.printed.find(LAST.hex())
            tshark.printed.find(one_register[1].pdu.hex())
            tshark.interrupt()
            rows = [row.split("\t") for row in tshark.printed.text.splitlines()]
    shown = [(port == "502", bytes.fromhex(payload)[6:]) for port, payload in rows if port]
    wanted = [
        frame
        for pdu in sequence
        for frame in ((False, rtu_adu(1, pdu)), (True, rtu_adu(1, KINDS[pdu])))
    ]
    begin = shown.index(wanted[0])
    found = shown[begin : begin + 2 * COUNT]
    assert [frame for _, frame in found] == [frame for _, frame in wanted]
    # Where a busy machine delays a frame of a line, a write may be taken for its equal response.
    wrong = [one[1] for one, right in zip(found, wanted, strict=True) if one != right]
    assert len(wrong) <= MAX_DOUBTFUL
    assert all(frame[1:-2] == KINDS.get(frame[1:-2]) for frame in wrong)
    warm_up = rtu_adu(1, WARM_UP)
    assert all(is_response == (frame != warm_up) for is_response, frame in shown[:begin])
