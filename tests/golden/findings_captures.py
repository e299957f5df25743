"""Makes captures/findings anew: python -m tests.golden.findings_captures FOLDER.

For each code one capture that shows it, and one that nearly does. They are made from bytes, with
times that are reckoned, so each run makes the same files.
"""

from __future__ import annotations

import struct
import sys
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

from mbtool.core import Packet, SerialFormat
from mbtool.modbus import mbap_adu, rtu_adu
from mbtool.packets.segment import ACK, RST
from tests.packets.building import MASTER, SLAVE, End, Talk, packet, pcap
from tests.uart import on_the_wire

if TYPE_CHECKING:
    from collections.abc import Iterable


FOLDER = Path(__file__).resolve().parents[2] / "captures" / "findings"
START_NS = 1_767_225_600_000_000_000
"""2026-01-01 00:00 UTC."""
MS = 1_000_000
LINE = SerialFormat(19200, 8, "E", 1)
USER0, RTAC, RAW_IP = 147, 250, 101
NANOSECONDS = 0xA1B23C4D

TOUCH = ("--device", "1=idec-ft1a-touch")
LT830 = ("--device", "2=chino-lt830")
SMARTAXIS = ("--device", "8=idec-ft1a-smartaxis")
PATIENT = ("--device", f"8={FOLDER / 'slave-of-smartaxis.toml'}")
FA3 = ("--device", f"{SLAVE}=fa3-at1m8x")
WAGO = ("--device", f"{SLAVE}=wago-750")

READ = "03 0000 0001"
VALUE = "03 02 1234"


@dataclass(frozen=True, slots=True)
class Case:
    """A code, and how to make what shows it and what nearly does."""

    code: str
    shows: Callable[[], bytes]
    nearly: Callable[[], bytes]
    options: tuple[str, ...] = ()
    beside: frozenset[str] = frozenset()
    """Codes that cannot but show beside it, in both captures."""


@dataclass
class Bus:
    """A line at 19200-8E1, as frames with the time of their last byte."""

    now_ns: int = START_NS
    packets: list[Packet] = field(default_factory=list)
    link_type: int = USER0

    def send(self, data: bytes, *, after_ms: float = 5.0) -> Bus:
        """Send bytes in one go, so long after the last one."""
        self.now_ns += round(after_ms * MS) + len(data) * LINE.character_ns
        return self.put(data)

    def put(self, data: bytes, event: int = 1) -> Bus:
        if self.link_type == RTAC:
            seconds, rest = divmod(self.now_ns, 10**9)
            data = struct.pack(">IIBBH", seconds, rest // 1000, event, 0, 0) + data
        self.packets.append(packet(data, self.now_ns, link_type=self.link_type))
        return self

    def frame(self, unit: int, pdu: str, *, after_ms: float = 5.0) -> Bus:
        return self.send(rtu_adu(unit, bytes.fromhex(pdu)), after_ms=after_ms)

    def torn(self, unit: int, pdu: str, *, at: int, by_ms: float) -> Bus:
        """A frame with a silence inside it."""
        data = rtu_adu(unit, bytes.fromhex(pdu))
        return self.send(data[:at]).send(data[at:], after_ms=by_ms)

    def asked(self, unit: int = 1, request: str = READ, answer: str = VALUE) -> Bus:
        return self.frame(unit, request, after_ms=150).frame(unit, answer)

    def file(self) -> bytes:
        return pcap(self.packets, magic=NANOSECONDS)


@dataclass
class Net:
    """Modbus/TCP connections to one slave, in packets that begin with IP."""

    now_ns: int = START_NS
    packets: list[Packet] = field(default_factory=list)
    ids: int = 0

    def wait(self, ms: float) -> Net:
        self.now_ns += round(ms * MS)
        return self

    def add(self, one: Packet) -> Net:
        self.now_ns += MS
        # Without its Ethernet header and padding; the IP header says how long it is.
        size = int.from_bytes(one.data[16:18], "big")
        data = one.data[14 : 14 + size]
        self.packets.append(
            replace(one, data=data, ts_ns=self.now_ns, link_type=RAW_IP, original_length=size)
        )
        return self

    def open(self, port: int = 49152, *, master: str = MASTER, slave: str = SLAVE) -> Talk:
        talk = Talk(End(master, port, 1000), End(slave, 502, 5000))
        for one in talk.handshake():
            self.add(one)
        return talk

    def ask(
        self, talk: Talk, pdu: str, *, number: int | None = None, protocol: int = 0, unit: int = 1
    ) -> Net:
        if number is None:
            self.ids = number = self.ids + 1
        return self.add(talk.request(_adu(number, pdu, protocol, unit)))

    def answer(self, talk: Talk, pdu: str, *, number: int | None = None, unit: int = 1) -> Net:
        number = self.ids if number is None else number
        return self.add(talk.response(_adu(number, pdu, unit=unit)))

    def asked(self, talk: Talk, request: str = READ, answer: str = VALUE, *, unit: int = 1) -> Net:
        return self.ask(talk, request, unit=unit).answer(talk, answer, unit=unit)

    def asked_of(self, unit: int, *, answered_by: int) -> Net:
        talk = self.open()
        return self.ask(talk, READ, unit=unit).answer(talk, VALUE, unit=answered_by)

    def file(self) -> bytes:
        return pcap(self.packets, magic=NANOSECONDS)


def _adu(number: int, pdu: str, protocol: int = 0, unit: int = 1) -> bytes:
    whole = mbap_adu(number, unit, bytes.fromhex(pdu))
    return whole[:2] + protocol.to_bytes(2, "big") + whole[4:]


def exchange(request: str, answer: str) -> Callable[[], bytes]:
    """On a connection that is captured from its beginning, between two reads."""

    def make() -> bytes:
        net = Net()
        talk = net.open()
        return net.asked(talk).wait(50).asked(talk, request, answer).wait(50).asked(talk).file()

    return make


def on_a_line(unit: int, request: str, answer: str) -> Callable[[], bytes]:
    """On a serial line, the last thing that happens."""
    return lambda: Bus().asked(unit, request, answer).file()


def broadcast(*answer: str, pdu: str = "10 0000 0001 02 1234", wait_ms: float = 150) -> bytes:
    bus = Bus().asked().frame(0, pdu)
    for one in answer:
        bus.frame(1, one, after_ms=10)
    return bus.frame(1, READ, after_ms=wait_ms).frame(1, VALUE).file()


def unanswered(follows_ms: float) -> bytes:
    net = Net()
    talk = net.open()
    net.asked(talk).wait(50).ask(talk, "04 0000 0001").wait(follows_ms)
    return net.asked(talk).file()


def repeated(*, first_is_answered: bool) -> bytes:
    net = Net()
    talk = net.open()
    net.asked(talk).wait(50).ask(talk, "04 0000 0001")
    if first_is_answered:
        net.answer(talk, "04 02 0007")
    net.wait(1000).asked(talk, "04 0000 0001", "04 02 0007")
    return net.wait(1500).asked(talk).file()


def unasked(*, is_joined: bool) -> bytes:
    net = Net()
    talk = Talk() if is_joined else net.open()
    if not is_joined:
        net.asked(talk).wait(50)
    return net.answer(talk, "04 02 0007", number=77).wait(50).asked(talk).file()


def polled(late_ms: float) -> bytes:
    net = Net()
    talk = net.open()
    for number in range(48):
        net.asked(talk).wait(98 + (late_ms if number % 8 == 7 else 0))
    return net.file()


def glued(*, is_glued: bool) -> bytes:
    bus = Bus()
    for _ in range(10):
        bus.frame(1, READ, after_ms=150).frame(1, VALUE, after_ms=0.0 if is_glued else 5.0)
    return bus.file()


def paused(*, by_ms: float, times: int) -> bytes:
    """Unit 2 is asked four times, so often with a silence inside the request."""
    bus = _beside_unit_1()
    for number in range(4):
        if number < times:
            bus.torn(2, READ, at=3, by_ms=by_ms).frame(2, VALUE)
        else:
            bus.asked(2)
    return bus.file()


def hasty(*, times: int) -> bytes:
    """Unit 2 is asked four times, and answers so often before the silence is over."""
    bus = _beside_unit_1()
    for number in range(4):
        bus.frame(2, READ).frame(2, VALUE, after_ms=1.0 if number < times else 5.0)
    return bus.file()


def _beside_unit_1() -> Bus:
    bus = Bus()
    for _ in range(12):
        bus.asked()
    return bus


def damaged(*, is_damaged: bool) -> bytes:
    request = rtu_adu(1, bytes.fromhex("06 0001 0005"))
    if is_damaged:
        return Bus().asked().send(request[:-1] + b"\x00", after_ms=150).asked().file()
    return Bus().asked().send(request, after_ms=150).send(request).asked().file()


def stray(*, is_between: bool) -> bytes:
    bus = Bus()
    if is_between:
        bus.asked()
    return bus.send(b"\x00\xff\x55", after_ms=50).asked().file()


def misheard(polls: int) -> bytes:
    """A line at 9600 baud, as a port at 19200 baud hears it."""
    frames = [rtu_adu(1, bytes.fromhex(pdu)) for pdu in (READ, VALUE)] * polls
    bus, begun = Bus(), False
    for one in on_the_wire(frames, replace(LINE, baud=9600)).heard(LINE):
        end_ns = START_NS + round(one.end_ns)
        data = bytes([one.value])
        if begun and end_ns - bus.now_ns < 5 * MS:
            last = bus.packets.pop()
            data = last.data + data
        begun, bus.now_ns = True, end_ns
        bus.put(data)
    return bus.file()


def driver(event: int) -> bytes:
    bus = Bus(link_type=RTAC).asked()
    bus.now_ns += 50 * MS
    return bus.put(b"", event).asked().file()


def paced(after_ms: float) -> bytes:
    bus = Bus().asked(8, "03 06AE 0002", "03 04 1234 5678")
    return bus.frame(8, "03 06AE 0001", after_ms=after_ms).frame(8, "03 02 1234").file()


def ids(second: int) -> bytes:
    net = Net()
    talk = net.open()
    net.ask(talk, READ, number=1).ask(talk, "04 0000 0001", number=second)
    return net.answer(talk, VALUE, number=1).answer(talk, "04 02 0007", number=second).file()


def answered_with(number: int) -> bytes:
    net = Net()
    talk = net.open()
    return net.ask(talk, READ, number=4).answer(talk, VALUE, number=number).file()


def protocol(number: int) -> bytes:
    net = Net()
    talk = net.open()
    net.asked(talk).wait(50).ask(talk, READ, protocol=number)
    if not number:
        net.answer(talk, VALUE)
    return net.wait(50).asked(talk).file()


def first_bytes(data: bytes, answer: bytes = b"") -> bytes:
    net = Net()
    talk = net.open()
    net.add(talk.request(data))
    if answer:
        net.add(talk.response(answer))
    for one in talk.goodbye():
        net.add(one)
    return net.file()


def junk(*, is_joined: bool) -> bytes:
    net = Net()
    talk = Talk() if is_joined else net.open()
    if not is_joined:
        net.asked(talk).wait(50)
    net.add(talk.request(b"GARBAGE!"))
    return net.wait(50).asked(talk).wait(2000).asked(talk).file()


def sent_again(*, is_other: bool) -> bytes:
    net = Net()
    talk = net.open()
    net.asked(talk)
    at = talk.master.sequence
    net.ask(talk, "06 0001 0005")
    again = _adu(net.ids, "06 0001 0009" if is_other else "06 0001 0005")
    net.add(talk.at(talk.master, at, again))
    return net.answer(talk, "06 0001 0005").file()


def connections(*, closes_one: bool) -> bytes:
    net = Net()
    first, second = net.open(50001), net.open(50002)
    net.asked(first).asked(second)
    if closes_one:
        for one in first.goodbye():
            net.add(one)
    third = net.open(50003)
    if not closes_one:
        net.add(first.send(first.slave, flags=RST | ACK))
    return net.asked(third).file()


def reset(*, opens_after_ms: float | None = None, answer: str | None = None) -> bytes:
    net = Net()
    talk = net.open(50001)
    net.asked(talk).wait(50).ask(talk, "41 00")
    if answer is not None:
        return net.answer(talk, answer).wait(1500).asked(talk).file()
    net.add(talk.send(talk.slave, flags=RST | ACK))
    if opens_after_ms is not None:
        net.wait(opens_after_ms)
        return net.asked(net.open(50002)).file()
    return net.file()


def answers_on() -> bytes:
    """A remote reset without an answer, after which the module goes on."""
    net = Net()
    talk = net.open(50001)
    return net.asked(talk).wait(50).ask(talk, "41 00").wait(1500).asked(talk).file()


def converted(*, is_on: bool) -> bytes:
    net = Net()
    talk = net.open()
    net.asked(talk, "06 0102 00FE", "06 0102 00FE").wait(20)
    net.asked(talk, "05 0009 FF00", "05 0009 FF00").wait(20)
    net.asked(talk, "02 0009 0001", "02 01 01").wait(20)
    net.asked(talk, "05 0009 0000", "05 0009 0000").wait(20)
    net.asked(talk, "02 0010 0008", f"02 01 {int(is_on):02X}").wait(20)
    return net.asked(talk, "04 0002 0001", "04 02 2EE0").file()


def single(request: str, answer: str) -> bytes:
    net = Net()
    return net.asked(net.open(), request, answer).file()


def initial_setting(completed: int) -> bytes:
    net = Net()
    talk = net.open()
    net.asked(talk, "05 0009 FF00", "05 0009 FF00").wait(20)
    net.asked(talk, "02 0009 0001", f"02 01 {completed:02X}").wait(20)
    return net.asked(talk, "05 0009 0000", "05 0009 0000").file()


def applied(*, is_applied: bool) -> bytes:
    net = Net()
    talk = net.open()
    net.asked(talk, "06 0102 005C", "06 0102 005C").wait(20)
    if is_applied:
        net.asked(talk, "05 0009 FF00", "05 0009 FF00").wait(20)
        net.asked(talk, "02 0009 0001", "02 01 01").wait(20)
        net.asked(talk, "05 0009 0000", "05 0009 0000").wait(20)
    return net.asked(talk, "04 0002 0001", "04 02 2EE0").file()


def checked_alive(*, unanswered: int) -> bytes:
    net = Net()
    talk = net.open()
    net.asked(talk)
    for _ in range(unanswered):
        net.wait(10_000).add(talk.at(talk.slave, talk.slave.sequence - 1))
    return net.wait(10_000).add(talk.send(talk.slave, flags=RST | ACK)).file()


def in_parts(*, seconds: int) -> bytes:
    """A request whose second half comes so long after its first."""
    net = Net()
    talk = net.open()
    whole = _adu(1, READ)
    net.add(talk.request(whole[:7])).wait(seconds * 1000).add(talk.request(whole[7:]))
    return net.answer(talk, VALUE, number=1).file()


def tripped(*, recovers: bool) -> bytes:
    net = Net()
    talk = net.open()
    net.asked(talk).wait(20).asked(talk, READ, "83 04").wait(20)
    return net.asked(talk, READ, VALUE if recovers else "83 04").file()


def _registers(count: int) -> str:
    return f"10 0000 {count:04X} {2 * count:02X} " + "0000" * count


CASES = (
    # Devices.
    Case(
        "FT1A-F15",
        on_a_line(1, "0F 0000 0003 01 05", "8F 01"),
        on_a_line(1, "05 0000 FF00", "05 0000 FF00"),
        TOUCH,
    ),
    Case(
        "FT1A-Q16",
        on_a_line(1, _registers(110), "90 02"),
        on_a_line(1, _registers(100), "10 0000 0064"),
        TOUCH,
    ),
    Case(
        "FT1A-A3",
        on_a_line(1, "03 0FFF 0002", "83 02"),
        on_a_line(1, "03 0FFF 0001", VALUE),
        TOUCH,
    ),
    Case(
        "SMARTAXIS-W16",
        on_a_line(8, "10 2328 0001 02 000A", "90 02"),
        on_a_line(8, "10 0000 0001 02 000A", "10 0000 0001"),
        SMARTAXIS,
    ),
    Case(
        "FA3-V6",
        exchange("06 00F2 4E20", "06 00F2 4E20"),
        exchange("06 00F2 3840", "06 00F2 3840"),
        FA3,
    ),
    Case("FA3-D67", exchange("43 01", "C3 03"), exchange("43 00", "43 00"), FA3),
    Case(
        "FT1A-E3",
        on_a_line(1, READ, "83 03"),
        on_a_line(1, "03 1000 0001", "83 02"),
        (*TOUCH, "--ignore", "FT1A-A"),
    ),
    Case(
        "LT830-L1",
        on_a_line(2, "01 0064 0002", "01 01 01"),
        on_a_line(2, "01 0064 0001", "01 01 01"),
        LT830,
    ),
    Case(
        "SMARTAXIS-C3",
        on_a_line(8, "03 07D0 0001", "83 03"),
        on_a_line(8, "03 07CF 0001", "83 02"),
        (*SMARTAXIS, "--ignore", "SMARTAXIS-A"),
    ),
    Case("FA3-R67", exchange("43 00", "43 01"), exchange("43 00", "43 00"), FA3),
    Case("FA3-M66", exchange("42 00", "42 0099"), exchange("42 00", "42 0016"), FA3),
    Case(
        "LT830-U100",
        on_a_line(100, READ, VALUE),
        on_a_line(99, READ, VALUE),
        ("--device", "all=chino-lt830"),
    ),
    # Requests.
    Case(
        "MB-101",
        exchange("10 0000 0002 04 1234", "90 03"),
        exchange("10 0000 0001 02 1234", "10 0000 0001"),
    ),
    Case("MB-102", exchange("03 0000 00", "83 03"), exchange(READ, "83 03")),
    Case("MB-103", exchange("05 0000 0001", "85 03"), exchange("05 0000 FF00", "05 0000 FF00")),
    Case("MB-104", exchange("03 0000 007E", "83 03"), exchange("03 0000 007D", "83 03")),
    Case(
        "MB-105",
        exchange("0F 0000 0003 01 F5", "0F 0000 0003"),
        exchange("0F 0000 0003 01 05", "0F 0000 0003"),
    ),
    Case("MB-106", exchange("03 FFFF 0002", "83 02"), exchange("03 FFFE 0002", "83 02")),
    Case("MB-107", exchange("00 00", "80 01"), exchange("7C 00", "FC 01")),
    Case("MB-108", on_a_line(248, READ, VALUE), on_a_line(247, READ, VALUE)),
    Case("MB-109", exchange("2A 00", "AA 01"), exchange("41 00", "C1 01")),
    # Answers.
    Case(
        "MB-201", exchange("06 0001 1234", "06 0001 1235"), exchange("06 0001 1234", "06 0001 1234")
    ),
    Case("MB-202", exchange("03 0000 0002", VALUE), exchange("03 0000 0002", "03 04 1234 5678")),
    Case("MB-203", exchange(READ, "83 02 00"), exchange(READ, "83 02")),
    Case("MB-204", exchange("01 0000 000B", "01 02 21FB"), exchange("01 0000 000B", "01 02 2103")),
    # Broadcasts.
    Case("MB-301", lambda: broadcast("10 0000 0001"), broadcast),
    Case("MB-302", lambda: broadcast(pdu=READ), lambda: broadcast(pdu="06 0000 0001")),
    # Question and answer.
    Case("MB-401", lambda: unanswered(2000), lambda: unanswered(200)),
    Case(
        "MB-402",
        lambda: repeated(first_is_answered=False),
        lambda: repeated(first_is_answered=True),
    ),
    Case("MB-403", lambda: unasked(is_joined=False), lambda: unasked(is_joined=True)),
    Case("MB-404", lambda: polled(100), lambda: polled(30)),
    # A serial line.
    Case(
        "RTU-101",
        lambda: paused(by_ms=1.2, times=3),
        lambda: paused(by_ms=1.2, times=1),
    ),
    Case(
        "RTU-102",
        lambda: paused(by_ms=10, times=3),
        lambda: paused(by_ms=10, times=1),
    ),
    Case(
        "RTU-103",
        lambda: hasty(times=3),
        lambda: hasty(times=1),
    ),
    Case("RTU-104", lambda: glued(is_glued=True), lambda: glued(is_glued=False)),
    Case("RTU-201", lambda: damaged(is_damaged=True), lambda: damaged(is_damaged=False)),
    Case("RTU-202", lambda: stray(is_between=True), lambda: stray(is_between=False)),
    Case("RTU-203", lambda: driver(0x07), lambda: driver(0x00)),
    Case("RTU-204", lambda: misheard(polls=12), lambda: misheard(polls=1)),
    Case("RTU-301", lambda: paced(3.0), lambda: paced(6.0), PATIENT),
    Case("RTU-302", lambda: broadcast(wait_ms=40), lambda: broadcast(wait_ms=120)),
    # Connections.
    Case("TCP-101", lambda: ids(1), lambda: ids(2)),
    Case("TCP-102", lambda: answered_with(5), lambda: answered_with(4)),
    Case("TCP-103", lambda: protocol(1), lambda: protocol(0)),
    Case(
        "TCP-201",
        lambda: first_bytes(bytes.fromhex("16 0301 0010 01 00000c 0303") + bytes(9)),
        lambda: first_bytes(_adu(0x1603, READ), _adu(0x1603, VALUE)),
    ),
    Case("TCP-202", lambda: junk(is_joined=False), lambda: junk(is_joined=True)),
    Case("TCP-203", lambda: sent_again(is_other=True), lambda: sent_again(is_other=False)),
    # Families of devices.
    Case("FA3-X1", lambda: protocol(1), lambda: protocol(0), FA3),
    Case(
        "FA3-X2", lambda: connections(closes_one=False), lambda: connections(closes_one=True), FA3
    ),
    Case("FA3-X3", reset, lambda: reset(answer="C1 03"), FA3),
    Case(
        "FA3-X4",
        lambda: reset(opens_after_ms=1000),
        lambda: reset(opens_after_ms=2100),
        FA3,
        frozenset({"FA3-X3"}),
    ),
    Case("FA3-X5", lambda: initial_setting(0), lambda: initial_setting(1), FA3),
    Case("FA3-X6", lambda: applied(is_applied=False), lambda: applied(is_applied=True), FA3),
    Case("FA3-X7", lambda: checked_alive(unanswered=3), lambda: checked_alive(unanswered=2), FA3),
    Case("FA3-X8", lambda: in_parts(seconds=40), lambda: in_parts(seconds=29), FA3),
    Case(
        "FA3-X9",
        answers_on,
        lambda: reset(opens_after_ms=2500),
        FA3,
        frozenset({"FA3-X3"}),
    ),
    Case("FA3-X10", lambda: converted(is_on=False), lambda: converted(is_on=True), FA3),
    Case(
        "FA3-X11",
        lambda: single("04 0001 0001", "04 02 0E30"),
        lambda: single("04 0001 0001", "04 02 0000"),
        FA3,
    ),
    Case(
        "TCP-104",
        lambda: Net().asked_of(1, answered_by=2).file(),
        lambda: Net().asked_of(1, answered_by=1).file(),
    ),
    Case("FA3-X12", lambda: single("42 00", "42 0013"), lambda: single("42 00", "42 0016"), FA3),
    Case("WAGO-X1", lambda: tripped(recovers=False), lambda: tripped(recovers=True), WAGO),
)


def all_cases() -> tuple[Case, ...]:
    """The cases of all codes."""
    # The cases of attacks and scans are made with the classes of this module.
    from tests.golden.security_captures import SECURITY_CASES

    return (*CASES, *SECURITY_CASES)


def files() -> Iterable[tuple[str, bytes]]:
    """Each file's name and bytes."""
    for case in all_cases():
        yield f"{case.code}.pcap", case.shows()
        yield f"{case.code}-nearly.pcap", case.nearly()


def main(folder: Path) -> None:
    for name, data in files():
        (folder / name).write_bytes(data)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
