"""Makes the captures of captures/ anew: python -m tests.golden.make_captures FOLDER.

Needs mbpoll, tcpdump and dumpcap (Debian: mbpoll, tcpdump, wireshark-common), and root: one capture
is of the loopback interface, with a slave at port 502.
"""

# The traffic is that of the commands and programs that captures/README.md names. Times, connection
# numbers and Linux's ports differ from run to run, so pytest tests/golden --update-golden must
# follow, and each changed line be read.

from __future__ import annotations

import os
import sys
import threading
from contextlib import ExitStack, chdir, closing, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from pymodbus import FramerType
from pymodbus.client import ModbusSerialClient

from mbtool.core import Direction, Endpoint, SerialFormat, SerialLink, TcpLink
from mbtool.master.links import open_master
from mbtool.modbus import Response, encode_pdu, rtu_adu
from mbtool.slave.device import Units
from mbtool.slave.shells import SerialSlave
from mbtool.workflows.demo import MODULE_UNIT, module_requests
from tests.end_to_end.peers import ask_twenty, pymodbus_server, tcp_client
from tests.end_to_end.programs import Program, answering, mbtool, required, sniffing, tcp_port
from tests.sources.live_helpers import MASTER_TIMEOUT_NS

if TYPE_CHECKING:
    from collections.abc import Iterator

LINE = SerialFormat(19200, 8, "E", 1)
ENDS = ("./plc", "./touch", "./rs485")
TAP = f"rtu:./rs485@{LINE}"
RETRY_S = 0.3
TEAR_S = 0.02
SETTLE_S = 1.0
"""How long tcpdump and dumpcap may take to see the last packet."""

TOUCH_IMAGE = """
HR400001 = [100, 200, 300, 400]
IR300001 = [2310, 498]
C6 = 1
C9 = [1, 1]
I100001 = [1, 0, 1]
"""
MODULE_IMAGE = """
RWr2 = [12000, 4000, 0, 0, 0, 2700, 0, 37]
X9 = 1
X10 = [1, 1, 0, 0, 0, 1, 0, 1]
"""
MBPOLL_RUNS = """
-t 4 -r 1 -c 4
-t 3 -r 1 -c 2
-t 0 -r 1 -c 11
-t 1 -r 1 -c 8
-t 4 -r 1 / 4660
-t 4 -r 2 / 22136 7 42
-t 0 -r 1 / 1
-t 0 -r 1 / 1 0 1
-t 4 -r 4096 -c 2
-t 4 -r 1 -c 4
-t 0 -r 1 -c 11
"""
"""Options before the port / values behind it."""


def main(folder: Path) -> None:
    with chdir(folder):
        ft1a_touch_line("ft1a-touch-line.mcap")
        ft1a_touch_line("ft1a-touch-line-evidence.mcap", "--evidence-only")
        fa3_at1m8x_setup("fa3-at1m8x-setup")
        polling_with_exceptions("polling-with-exceptions.mcap")
        retry_after_silence("retry-after-silence.mcap")
        broadcast_write("broadcast-write.mcap")
        torn_and_glued_frames("torn-and-glued-frames.mcap")
        ascii_line("ascii-line.mcap")
        for capture in Path().iterdir():
            capture.chmod(0o644)


def ft1a_touch_line(log: str, *options_of_log: str) -> None:
    """mbpoll as the master of the embedded FT1A Touch."""
    mbpoll = required("mbpoll", "mbpoll")
    Path("touch.toml").write_text(TOUCH_IMAGE)
    slave = ("slave", "idec-ft1a-touch", "--on", f"rtu:./touch@{LINE}", "--image", "touch.toml")
    runs = [run.partition("/") for run in MBPOLL_RUNS.strip().splitlines()]
    with (
        virtual_line(LINE),
        answering(*slave),
        recording(log, len(runs), TAP, *options_of_log, touch=True),
    ):
        for options, _, values in runs:
            command = [mbpoll, "-m", "rtu", "-b", str(LINE.baud), "-P", "none", "-a", "1", "-1"]
            with Program(*command, *options.split(), "./plc", *values.split()) as one:
                one.wait()
    Path("touch.toml").unlink()


def fa3_at1m8x_setup(name: str) -> None:
    """The start-up of the module's manual, chapter 10.5: one run, captured in four ways."""
    Path("module.toml").write_text(MODULE_IMAGE)
    requests = module_requests()
    slave = ("slave", "fa3-at1m8x", "--unit", str(MODULE_UNIT), "--on", "tcp:127.0.0.1:502")
    device = ("--device", "127.0.0.1=fa3-at1m8x")
    tcpdump, dumpcap = required("tcpdump", "tcpdump"), required("dumpcap", "wireshark-common")
    with ExitStack() as stack:
        stack.enter_context(answering(*slave, "--image", "module.toml"))
        packets = [
            Program(tcpdump, "-i", "lo", "-U", "-w", f"{name}.pcap", "tcp port 502"),
            Program(dumpcap, "-i", "lo", "-w", f"{name}.pcapng", "-f", "tcp port 502"),
        ]
        for program, word in zip(packets, ("listening on", "File:"), strict=True):
            stack.enter_context(program).said.find(word)
        log = (f"{name}-packets.mcap", len(requests), "net:lo", *device)
        stack.enter_context(recording(*log))
        log = (f"{name}.mcap", len(requests), "tap:127.0.0.1:0=127.0.0.1:502", *device)
        sniffer = stack.enter_context(recording(*log))
        with open_master(
            TcpLink(Endpoint("127.0.0.1", tcp_port(sniffer))), MASTER_TIMEOUT_NS
        ) as master:
            for pdu in requests:
                assert master.ask(MODULE_UNIT, pdu)
        threading.Event().wait(SETTLE_S)
        for program in packets:
            assert program.interrupt() == 0
    Path("module.toml").unlink()


def polling_with_exceptions(log: str) -> None:
    """A pymodbus client asks a pymodbus server twenty things, and again when its data changed."""
    with (
        pymodbus_server() as (port, change),
        recording(log, 40, f"tap:127.0.0.1:0=127.0.0.1:{port}") as sniffer,
        tcp_client(tcp_port(sniffer)) as (client, _),
    ):
        ask_twenty(client)
        change()
        ask_twenty(client)


def retry_after_silence(log: str) -> None:
    """pymodbus asks again when a slave leaves its second request unanswered."""
    link = SerialLink("./touch", LINE)
    with (
        virtual_line(LINE),
        SerialSlave(link, Units({1: _DeafAtTheSecond()})),
        recording(log, 4, TAP, touch=True),
        rtu_master() as master,
    ):
        for _ in range(3):
            assert not master.read_holding_registers(0, count=2, device_id=1).isError()


class _DeafAtTheSecond:
    """Answers all but its second request: with how many have been asked, and 22136."""

    def __init__(self) -> None:
        self._asked = 0

    def respond(self, unit: int, pdu: bytes, now_ns: int) -> Response | None:
        self._asked += 1
        if self._asked == 2:
            return None
        return Response(encode_pdu(pdu[0], Direction.RESPONSE, values=(self._asked, 22136)))


def broadcast_write(log: str) -> None:
    """A write to all units, which none answers, and what it did to unit 1."""
    slave = ("slave", "idec-ft1a-touch", "--on", f"rtu:./touch@{LINE}")
    with (
        virtual_line(LINE),
        answering(*slave),
        recording(log, 3, TAP, touch=True),
        rtu_master() as master,
    ):
        master.read_holding_registers(0, count=1, device_id=1)
        master.write_register(0, 4660, device_id=0, no_response_expected=True)
        threading.Event().wait(RETRY_S)  # The turnaround delay of a master.
        master.read_holding_registers(0, count=1, device_id=1)


def torn_and_glued_frames(log: str) -> None:
    """What adapters make of frames: pauses inside them, none between them, noise, a bad CRC."""
    request = rtu_adu(1, encode_pdu(0x03, Direction.REQUEST, address=0, quantity=2))
    response = rtu_adu(1, encode_pdu(0x03, Direction.RESPONSE, values=(4660, 22136)))
    writes = [
        # A request and an answer as they should be.
        [request],
        [response],
        # The request torn in two, the answer in three.
        [request[:3], request[3:]],
        [response[:1], response[1:6], response[6:]],
        # The answer follows its request without a silence.
        [request + response],
        # Two exchanges without any silence.
        [request + response + request + response],
        # Noise right before a request, and alone.
        [b"\x00\xff" + request],
        [response],
        [b"\xff"],
        # An answer with a wrong CRC, after which the master asks again.
        [request],
        [response[:-1] + bytes([response[-1] ^ 0xFF])],
        [request],
        [response],
    ]
    with virtual_line(LINE), recording(log, 8, TAP, touch=True), _opened("./plc") as port:
        for pieces in writes:
            for piece in pieces:
                os.write(port, piece)
                on_the_line_s = len(piece) * LINE.character_ns / 1e9
                threading.Event().wait(on_the_line_s + TEAR_S)
            threading.Event().wait(5 * TEAR_S)


def ascii_line(log: str) -> None:
    """pymodbus as the master of an embedded slave in ASCII."""
    line = SerialFormat(9600, 7, "E", 1)
    slave = ("slave", "idec-ft1a-touch", "--on", f"ascii:./touch@{line}")
    with (
        virtual_line(line),
        answering(*slave),
        recording(log, 4, f"ascii:./rs485@{line}"),
        rtu_master(FramerType.ASCII, line.baud) as master,
    ):
        master.write_registers(0, [4660, 22136], device_id=1)
        master.read_holding_registers(0, count=2, device_id=1)
        master.write_coils(0, [True, False, True], device_id=1)
        master.read_coils(0, count=3, device_id=1)


@contextmanager
def virtual_line(line: SerialFormat) -> Iterator[None]:
    with mbtool("line", *ENDS, "--settings", str(line)) as program:
        program.said.find("ends of one line")
        yield
        program.interrupt()


@contextmanager
def recording(
    log: str, transactions: int, link: str, *options: str, touch: bool = False
) -> Iterator[Program]:
    """`mbtool sniff`, until it has seen so many transactions."""
    names = ("--device", "1=idec-ft1a-touch") if touch else ()
    with sniffing(link, "-w", log, "--overwrite", *names, *options) as sniffer:
        yield sniffer
        sniffer.printed.take(transactions)
        sniffer.interrupt()


@contextmanager
def rtu_master(
    framer: FramerType = FramerType.RTU, baud: int = LINE.baud
) -> Iterator[ModbusSerialClient]:
    master = ModbusSerialClient("./plc", framer=framer, baudrate=baud, timeout=RETRY_S, retries=1)
    assert master.connect()
    with closing(master):
        yield master


@contextmanager
def _opened(port: str) -> Iterator[int]:
    descriptor = os.open(port, os.O_RDWR | os.O_NOCTTY)
    try:
        yield descriptor
    finally:
        os.close(descriptor)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
