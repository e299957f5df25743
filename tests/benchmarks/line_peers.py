"""What other decoders make of a wire, for those of them that are installed."""

# Each is used as somebody who listens to a line would use it, and as kindly as it allows:
#
# tshark (4.0 and later) dissects packets, one for each burst between two silences of t3.5, as
# serial capture tools make them. Its check of the CRC, off by default, is on, and what fails it is
# not counted. A frame is found where a packet begins with it and the dissector takes it. It pairs a
# response with a request, but knows no outcome; a request that no response names counts as
# unanswered.
#
# pymodbus has framers for the two ends of a line, and none for one who listens to both: each read
# goes to a server's framer, which finds requests, and to a client's, which finds responses. What
# both find counts as ambiguous.
#
# "pymodbus searched" is the same classes, tried at every byte of all that was heard, as a careful
# user would build a listener from them. A frame is where a class knows the length and the CRC is
# right; of two the longer one. The search goes on behind it. It needs no times. Nothing in pymodbus
# joins requests and responses.
#
# modbus-sniffer (PyPI) decodes what came between two silences. It needs Python 3.12.

from __future__ import annotations

import contextlib
import importlib
import shutil
import struct
import subprocess
import time
from itertools import pairwise
from typing import TYPE_CHECKING, Any

from mbtool.core import Direction
from mbtool.modbus.adu import MAX_RTU_ADU, crc
from tests.benchmarks.adapters import Column
from tests.benchmarks.figures import Heard

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from tests.benchmarks.adapters import Read, Wire

    Peer = Callable[[Wire, Sequence[Read], Column], Heard]

LINKTYPE_USER0 = 147
DISSECTOR = 'uat:user_dlts:"User 0 (DLT=147)","mbrtu","0","","0",""'
TSHARK_FIELDS = (
    "frame.number", "mbrtu.unit_id", "mbrtu.crc16.status", "modbus.request_frame", "_ws.col.Info",
)  # fmt: skip
CRC_GOOD = "1"
MIN_FRAME = 4


def installed() -> tuple[dict[str, Peer], list[str]]:
    """The peers that are here, and the names of those that are not."""
    here: dict[str, Peer] = {}
    missing = []
    for name, usable, peer in (
        ("tshark", shutil.which("tshark") is not None, tshark),
        ("pymodbus", _module("pymodbus.framer") is not None, pymodbus),
        ("pymodbus searched", _module("pymodbus.framer") is not None, pymodbus_searched),
        ("modbus-sniffer", _module("modbus_sniffer.serial_snooper") is not None, modbus_sniffer),
    ):
        if usable:
            here[name] = peer
        else:
            missing.append(name)
    return here, missing


def bursts(wire: Wire, reads: Sequence[Read], column: Column) -> list[Read]:
    """Reads joined until none comes for t3.5; without times, as they are."""
    if column is Column.NO_TIMES or not reads:
        return list(reads)
    # A program that waits for the next read sees its time, not the time of its first byte.
    silence_ns = wire.line.t3_5_ns + wire.line.character_ns
    joined: list[Read] = [reads[0]]
    for (_, before_ns), (data, ts_ns) in pairwise(reads):
        if ts_ns - before_ns >= silence_ns:
            joined.append((data, ts_ns))
        else:
            joined[-1] = joined[-1][0] + data, ts_ns
    return joined


def tshark(wire: Wire, reads: Sequence[Read], column: Column) -> Heard:
    packets = bursts(wire, reads, column)
    begin = time.perf_counter()
    lines = _tshark_lines(packets)
    heard = Heard(transactions=[], seconds=time.perf_counter() - begin)
    assert heard.transactions is not None
    places, offset = [], 0
    open_requests: dict[int, None] = {}
    for (data, _), line in zip(packets, lines, strict=True):
        _, unit, crc_status, request_frame, told = line
        places.append(offset)
        if unit and crc_status == CRC_GOOD:
            direction = _tshark_direction(told)
            heard.frames.append((offset, _dissected(data), direction))
            if request_frame:
                request = places[int(request_frame) - 1]
                open_requests.pop(request, None)
                heard.transactions.append((request, offset, None))
            elif direction is Direction.REQUEST:
                open_requests[offset] = None
        offset += len(data)
    heard.transactions += [(request, None, None) for request in open_requests]
    return heard


def _tshark_lines(packets: Sequence[Read]) -> list[list[str]]:
    capture = bytearray(struct.pack("<IHHiIII", 0xA1B23C4D, 2, 4, 0, 0, 65535, LINKTYPE_USER0))
    for data, ts_ns in packets:
        seconds, ns = divmod(ts_ns, 1_000_000_000)
        capture += struct.pack("<IIII", seconds, ns, len(data), len(data)) + data
    fields = [each for name in TSHARK_FIELDS for each in ("-e", name)]
    done = subprocess.run(
        [
            "tshark", "-n", "-r", "-", "-o", DISSECTOR, "-o", "mbrtu.crc_verification:TRUE",
            "-T", "fields", "-E", "separator=/t", "-E", "occurrence=f", *fields,
        ],
        input=bytes(capture),
        capture_output=True,
        check=True,
    )  # fmt: skip
    return [line.split("\t") for line in done.stdout.decode().splitlines()]


def _dissected(packet: bytes) -> bytes:
    """The frame whose CRC was found correct: the packet, or its beginning if more is glued."""
    sizes = range(len(packet), MIN_FRAME - 1, -1)
    return next((packet[:size] for size in sizes if crc(packet[:size]) == 0), packet)


def _tshark_direction(told: str) -> Direction | None:
    match told.split(":")[0].strip():
        case "Query":
            return Direction.REQUEST
        case "Response":
            return Direction.RESPONSE
    return None


def pymodbus(wire: Wire, reads: Sequence[Read], column: Column) -> Heard:
    del wire, column
    from pymodbus import pymodbus_apply_logging_config
    from pymodbus.framer import FramerRTU
    from pymodbus.pdu import DecodePDU

    pymodbus_apply_logging_config("CRITICAL")

    class Listening(FramerRTU):
        """Notes what its decode() finds, which handleFrame() tells without its place."""

        found = b""

        def decode(self, data: bytes) -> tuple[int, int, int, bytes]:
            used, unit, transaction_id, pdu = super().decode(data)
            if pdu:
                body = bytes([unit]) + pdu
                self.found = body + self.compute_CRC(body).to_bytes(2, "big")
            return used, unit, transaction_id, pdu

    directions: dict[tuple[int, bytes], Direction | None] = {}
    begin = time.process_time()
    for is_server, direction in ((True, Direction.REQUEST), (False, Direction.RESPONSE)):
        framer, held, offset = Listening(DecodePDU(is_server)), b"", 0
        for data, _ in reads:
            held += data
            used = -1
            while used and held:
                framer.found = b""
                used = 0
                # What it cannot decode it raises for, after it has used it up; its users close.
                with contextlib.suppress(Exception):
                    used, _ = framer.handleFrame(held, 0, 0)
                if framer.found:
                    used = used or len(held)
                    key = offset + held.find(framer.found), framer.found
                    directions[key] = None if key in directions else direction
                held, offset = held[used:], offset + used
    seconds = time.process_time() - begin
    frames = [(offset, raw, each) for (offset, raw), each in sorted(directions.items(), key=_place)]
    return Heard(frames=frames, seconds=seconds)


def pymodbus_searched(wire: Wire, reads: Sequence[Read], column: Column) -> Heard:
    del wire, column
    from pymodbus import pymodbus_apply_logging_config
    from pymodbus.pdu import DecodePDU

    pymodbus_apply_logging_config("CRITICAL")
    decoders = ((DecodePDU(True), Direction.REQUEST), (DecodePDU(False), Direction.RESPONSE))
    heard = Heard()
    data = b"".join(data for data, _ in reads)
    begin = time.process_time()
    offset = 0
    while offset + MIN_FRAME <= len(data):
        rest = data[offset : offset + MAX_RTU_ADU]
        found = [(_pymodbus_size(decoder, rest), direction) for decoder, direction in decoders]
        size = max(size for size, _ in found)
        if size == 0:
            offset += 1
            continue
        directions = [direction for each, direction in found if each == size]
        direction = directions[0] if len(directions) == 1 else None
        heard.frames.append((offset, rest[:size], direction))
        offset += size
    heard.seconds = time.process_time() - begin
    return heard


def _pymodbus_size(decoder: Any, rest: bytes) -> int:
    """The size of the frame at the front for one end of the line, 0 if there is none."""
    from pymodbus.framer import FramerRTU

    size = 0
    # Its classes index what may not be there, and raise for what has no known length.
    with contextlib.suppress(Exception):
        pdu_class = decoder.lookupPduClass(rest)
        size = pdu_class.calculateRtuFrameSize(rest) if pdu_class else 0
    if not MIN_FRAME <= size <= len(rest):
        return 0
    received = int.from_bytes(rest[size - 2 : size], "big")
    if not FramerRTU.check_CRC(rest[: size - 2], received):
        return 0
    return size if decoder.decode(rest[1 : size - 2]) is not None else 0


def _place(item: tuple[tuple[int, bytes], Direction | None]) -> int:
    return item[0][0]


def modbus_sniffer(wire: Wire, reads: Sequence[Read], column: Column) -> Heard:
    snooper_module = _module("modbus_sniffer.serial_snooper")
    assert snooper_module is not None
    notes = _Notes()
    snooper: Any = snooper_module.SerialSnooper(
        notes, None, parity="N", raw_log=True, data_handler=notes.parsed
    )
    heard = Heard()
    offset = 0
    for data, _ in bursts(wire, reads, column):
        held = bytes(snooper.data) + data
        start = offset - len(snooper.data)
        notes.raw.clear()
        notes.directions.clear()
        begin = time.process_time()
        snooper.process_data(data)
        snooper.process_data(b"")  # The silence.
        heard.seconds += time.process_time() - begin
        place = 0
        for raw, direction in zip(notes.raw, notes.directions, strict=True):
            place = held.index(raw, place)
            heard.frames.append((start + place, raw, direction))
            place += len(raw)
        offset += len(data)
    return heard


class _Notes:
    """The log that modbus-sniffer writes to: the bytes of each frame, and who sent it."""

    def __init__(self) -> None:
        self.raw: list[bytes] = []
        self.directions: list[Direction] = []

    def info(self, text: str) -> None:
        name, _, value = text.partition(": ")
        if name == "Raw Message":
            self.raw.append(bytes.fromhex(value))

    def debug(self, text: object) -> None:
        pass

    def parsed(self, frame: dict[str, Any]) -> None:
        asked = frame["message_type"] == "request"
        self.directions.append(Direction.REQUEST if asked else Direction.RESPONSE)


def _module(name: str) -> Any:
    try:
        return importlib.import_module(name)
    except (ImportError, SyntaxError):
        return None
