"""The demo: records the traffic of two slaves, replays these slaves, and compares the responses."""

# A simulated FT1A Touch answers a master on a virtual serial line, where the sniffer listens. A
# simulated FA3-AT1M8X answers another master through a TCP tap of the sniffer. Both are recorded in
# one log. Then both slaves are replayed from the log on loopback, and the same requests must get
# the same responses.

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

from mbtool.core import (
    Direction,
    Endpoint,
    LinkError,
    LinkSpec,
    SerialFormat,
    SerialLink,
    TapLink,
    TcpLink,
    WireEvent,
)
from mbtool.decode.decoder import Decoder, Record
from mbtool.devices import Assignments, Namer, load_profile, parse_assignment
from mbtool.logs.opening import create_log
from mbtool.master.links import MasterLink, open_master
from mbtool.modbus import Responder, Table, encode_pdu
from mbtool.replay import RecordedSlave, Recording
from mbtool.slave.device import RegisterImage, units_on
from mbtool.slave.families import make_device
from mbtool.slave.shells import SerialSlave, TcpSlave
from mbtool.sources.tap import TapSource
from mbtool.sources.virtual_line import VirtualLine
from mbtool.workflows.shared.reading import Reading, ReadingOptions
from mbtool.workflows.sniff import Sniffer, serial_lines

if TYPE_CHECKING:
    from mbtool.modbus.layouts import Value

LINE = SerialFormat(19200, 8, "E", 1)
TOUCH_UNIT = 1
MODULE_UNIT = 0
"""The unit id that the module's manual tells a master to send; the module ignores it."""

Exchange = tuple[int, bytes, bytes | None]
"""A request and its response: the unit, the request PDU, and the response PDU, which is None if the
slave did not respond."""

_ANY = Endpoint("127.0.0.1", 0)
_QUIET_NS = 300_000_000
"""After the masters have ended, the sniffer listens for this time (ns) to hear the last bytes."""

_TIMEOUT_NS = 5_000_000_000
"""The response timeout of the demo's masters, in ns. It is long because a busy machine may be slow;
the demo's slaves always respond."""


@dataclass(frozen=True, slots=True)
class Agreement:
    """The result of comparing the responses of the replayed slaves with those of the
    recorded ones.
    """

    asked: int
    differences: tuple[Exchange, ...]
    """The requests whose replayed responses differ from the recorded ones; each item holds the
    replayed response."""


class Demo:
    """One run of the demo: call `record`, then `replay`. `assignments` tells which device has which
    profile.
    """

    def __init__(self, log_path: str, *, overwrite: bool = False) -> None:
        self._log_path = log_path
        self._overwrite = overwrite
        self._exchanges: list[Exchange] = []
        self._failure: BaseException | None = None
        self.assignments = Assignments()

    def record(self) -> Iterator[Record]:
        """Start two simulated devices, two masters and the sniffer, and yield what the sniffer
        decodes.
        """
        with ExitStack() as stack:
            folder = stack.enter_context(TemporaryDirectory(prefix="mbtool-"))
            names = [f"{folder}/{name}" for name in ("touch", "master", "rs485")]
            line = stack.enter_context(VirtualLine(ends=3, format=LINE, link_names=names))
            touch_port, master_port, tap_port = line.ports
            touch = SerialLink(touch_port, LINE)
            stack.enter_context(SerialSlave(touch, _touch(touch)))
            module = TcpSlave(TcpLink(_ANY), _module(TcpLink(_ANY)))
            stack.enter_context(module)
            links: list[LinkSpec] = [SerialLink(tap_port, LINE), TapLink(_ANY, module.endpoint)]
            self.assignments = Assignments(
                [
                    parse_assignment(f"{TOUCH_UNIT}=idec-ft1a-touch"),
                    parse_assignment(f"{module.endpoint}=fa3-at1m8x"),
                ]
            )
            decoder = Decoder(Namer(self.assignments), lines=serial_lines(links))
            begin = partial(
                create_log, self._log_path, links, self.assignments, overwrite=self._overwrite
            )
            sniffer = stack.enter_context(Sniffer(links, decoder, begin_log=begin))
            (tap,) = (source for source in sniffer.sources if isinstance(source, TapSource))
            masters = threading.Thread(
                target=self._ask_all,
                args=(SerialLink(master_port, LINE), tap.endpoint),
                daemon=True,
            )
            masters.start()
            yield from sniffer.records(_when_done(masters))
        if self._failure is not None:
            raise self._failure

    def replay(self) -> Agreement:
        """Replay the slaves from the log, send them all requests again, and compare the responses
        with those of `record`.
        """
        records = Reading([self._log_path], ReadingOptions()).records()
        recording = Recording.of(one for one in records if not isinstance(one, WireEvent))
        slave = TcpSlave(TcpLink(_ANY), RecordedSlave(recording, rate=None))
        with slave, open_master(TcpLink(slave.endpoint), _TIMEOUT_NS) as master:
            answers = [_answer(master, unit, pdu) for unit, pdu, _ in self._exchanges]
        differences = tuple(
            (unit, pdu, answer)
            for (unit, pdu, recorded), answer in zip(self._exchanges, answers, strict=True)
            if answer != recorded
        )
        return Agreement(len(answers), differences)

    def _ask_all(self, serial: SerialLink, tap: Endpoint) -> None:
        try:
            with (
                open_master(serial, _TIMEOUT_NS) as rtu,
                open_master(TcpLink(tap), _TIMEOUT_NS) as tcp,
            ):
                self._ask(tcp, MODULE_UNIT, module_requests())
                self._ask(rtu, TOUCH_UNIT, touch_requests())
        except Exception as error:
            self._failure = error

    def _ask(self, master: MasterLink, unit: int, requests: Sequence[bytes]) -> None:
        for pdu in requests:
            answer = _answer(master, unit, pdu)
            if answer is None:
                raise LinkError(f"unit {unit} does not answer the request {pdu.hex(' ')}")
            self._exchanges.append((unit, pdu, answer))


def _answer(master: MasterLink, unit: int, pdu: bytes) -> bytes | None:
    """Send a request (its PDU) to `unit`, at most three times, until a response comes. Return its
    PDU, None if none came.

    On a busy machine the virtual line may deliver a response in parts, which the master does not
    accept.
    """
    return next((one for _ in range(3) if (one := master.ask(unit, pdu)) is not None), None)


def touch_requests() -> list[bytes]:
    """The PDUs of requests to the FT1A Touch: reads and writes of its tables, and one write that is
    too long for it.
    """
    read = [
        _request(0x03, address=0, quantity=4),
        _request(0x04, address=0, quantity=2),
        _request(0x01, address=0, quantity=11),
        _request(0x02, address=0, quantity=8),
    ]
    write = [
        _request(0x06, address=0, value=0x1234),
        _request(0x10, address=1, values=(22136, 7, 42)),
        _request(0x05, address=0, value=0xFF00),
    ]
    too_long = _request(0x10, address=0, values=(0,) * 110)
    return [*read, *write, *read, too_long, read[0]]


def module_requests() -> list[bytes]:
    """The PDUs of requests to an FA3-AT1M8X: they set the module up (manual, 10.5) and read it; the
    last one reads undefined registers.
    """
    averaging = (0x0000, 0x2010, 0, 0, 0, 0, 0, 5000, 0, 100)
    return [
        b"\x42\x00",
        _request(0x06, address=0x0102, value=0x005C),
        _request(0x10, address=0x0105, values=averaging),
        _request(0x05, address=0x0009, value=0xFF00),
        _request(0x02, address=0x0009, quantity=1),
        _request(0x05, address=0x0009, value=0x0000),
        _request(0x02, address=0x0010, quantity=8),
        _request(0x04, address=0x0002, quantity=8),
        _request(0x03, address=0x0010, quantity=2),
    ]


def _request(code: int, **fields: Value) -> bytes:
    return encode_pdu(code, Direction.REQUEST, **fields)


def _touch(link: SerialLink) -> Responder:
    profile = load_profile("idec-ft1a-touch")
    image = RegisterImage.of(profile)
    image.set(Table.HOLDING_REGISTERS, 0, [100, 200, 300, 400])
    image.set(Table.INPUT_REGISTERS, 0, [2310, 498])
    image.set(Table.COILS, 0, [0, 0, 0, 0, 0, 1, 0, 0, 1, 1, 0])
    image.set(Table.DISCRETE_INPUTS, 0, [1, 0, 1])
    return units_on(link, profile, TOUCH_UNIT, make_device(profile, image))


def _module(link: TcpLink) -> Responder:
    profile = load_profile("fa3-at1m8x")
    image = RegisterImage.of(profile)
    image.set(Table.INPUT_REGISTERS, 2, [12000, 4000, 0, 0, 0, 2700, 0, 37])
    image.set(Table.DISCRETE_INPUTS, 0x09, [1])
    image.set(Table.DISCRETE_INPUTS, 0x10, [1, 1, 0, 0, 0, 1, 0, 1])
    return units_on(link, profile, MODULE_UNIT, make_device(profile, image))


def _when_done(masters: threading.Thread) -> Callable[[int], bool]:
    """Return a function that the sniffer calls to know whether it shall stop.

    Its argument is the time in ns. It returns True when the masters have ended at least _QUIET_NS
    ago.
    """
    since: list[int] = []

    def stop(now_ns: int) -> bool:
        if masters.is_alive():
            return False
        since.append(now_ns)
        return now_ns - since[0] > _QUIET_NS

    return stop
