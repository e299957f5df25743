"""A recorded session with an FA3 module: resets, refused connections, three at once, alive checks.

After a remote reset the module takes no connection for two seconds.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from mbtool.core import Packet
from mbtool.modbus import mbap_adu
from mbtool.packets.segment import ACK, RST, SYN
from tests.packets.building import MASTER, SLAVE, End, Talk, pcap

START_NS = 1_767_225_600_000_000_000
MS = 1_000_000
MODEL = bytes.fromhex("42 00"), bytes.fromhex("42 0016")  # 10.4: 0016H is FA3-AT1M8X
READ_X9 = bytes.fromhex("02 0009 0001"), bytes.fromhex("02 01 01")  # 10.5
REMOTE_RESET = bytes.fromhex("41 00")  # 10.4: no response, and no connection for 2 s


@dataclass
class Session:
    """Packets of connections to one module, in the order in which they are added."""

    now_ns: int = START_NS
    packets: list[Packet] = field(default_factory=list)

    def wait(self, ms: float) -> None:
        self.now_ns += round(ms * MS)

    def add(self, *packets: Packet) -> None:
        for one in packets:
            self.now_ns += MS
            self.packets.append(replace(one, ts_ns=self.now_ns))

    def talk(self, port: int) -> Talk:
        return Talk(End(MASTER, port, 1000 * port), End(SLAVE, 502, 5000 * port))

    def open(self, port: int) -> Talk:
        talk = self.talk(port)
        self.add(*talk.handshake())
        return talk

    def refused(self, port: int) -> None:
        talk = self.talk(port)
        self.add(talk.send(talk.master, flags=SYN), talk.send(talk.slave, flags=RST | ACK))

    def ask(self, talk: Talk, request: bytes, response: bytes | None, number: int = 0) -> None:
        self.add(talk.request(mbap_adu(number, 0, request)))
        if response is not None:
            self.add(talk.response(mbap_adu(number, 0, response)))

    def reset(self, talk: Talk) -> None:
        self.add(talk.send(talk.slave, flags=RST | ACK))


def session(*, resets: bool = True, refuses: bool = True, checks: bool = True) -> bytes:
    """Make the session as a pcap; what is False is left out of it."""
    made = Session()
    first = made.open(49152)
    made.ask(first, *MODEL)
    made.wait(40)
    made.ask(first, *READ_X9)
    made.wait(40)
    made.ask(first, REMOTE_RESET, None)
    if resets:
        made.reset(first)
    for number in range(3 if refuses else 0):
        made.wait(300)
        made.refused(49153 + number)
    made.wait(1500)  # So long that no busy machine confuses the refusals with what follows.
    second = made.open(49160)
    made.ask(second, *READ_X9)
    made.wait(40)
    third = made.open(49161)
    made.ask(third, *READ_X9)
    made.wait(40)
    fourth = made.open(49162)
    if resets:
        made.reset(second)  # 10.2: the connection without communication for the longest time
    made.wait(20)
    made.ask(fourth, *READ_X9)
    made.wait(100)
    if checks:
        for _ in range(3):  # 10.3: three alive checks, then the connection is ended by force
            made.add(third.at(third.slave, third.slave.sequence - 1))
            made.wait(20)
        made.reset(third)
    made.wait(40)
    made.ask(fourth, *READ_X9)
    made.add(*fourth.goodbye())
    return pcap(made.packets, magic=0xA1B23C4D)
