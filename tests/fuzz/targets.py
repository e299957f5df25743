"""What is fuzzed: for each target a function that takes any bytes and must not raise.

A user's file or text may be refused with an error of mbtool; every other exception is a finding,
and so is a byte of a line that is in no event.
"""

from __future__ import annotations

import io
import tempfile
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

from mbtool.core import Chunk, Direction, Packet, SerialFormat
from mbtool.core.errors import MbtoolError
from mbtool.core.link_spec import parse_link
from mbtool.decode.decoder import Decoder
from mbtool.devices import Namer, load_profile
from mbtool.devices.importing.register_list import import_register_list
from mbtool.devices.loading import profile_from_json, profile_to_json
from mbtool.framing import MbapSplitter, RtuStreamSplitter
from mbtool.logs import LogReader
from mbtool.packets.capture import read_capture
from mbtool.query.where import parse_where
from mbtool.serial_line import AsciiSplitter, RtuSplitter
from mbtool.slave.device.image import RegisterImage
from mbtool.slave.device.image_file import load_image
from mbtool.slave.faults.fault_file import FaultFile
from mbtool.sources.byte_times import read_byte_times
from mbtool.sources.text_frames import whole_frames
from mbtool.sources.text_log import TextLog
from tests.feeding import Line, byte_by_byte, feed_all, whole
from tests.modbus.reading import raw
from tests.query.test_where import READ

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from mbtool.devices import Profile

FORMAT = SerialFormat(19200, 8, "E", 1)
SILENCES_NS = (0, FORMAT.t1_5_ns, FORMAT.t3_5_ns - 1, FORMAT.t3_5_ns, 5_000_000, 2_000_000_000)
LINK_TYPES = (1, 0, 12, 101, 108, 113, 147, 228, 229, 250, 276)
MAX_PACKETS = 64


def rtu(data: bytes) -> None:
    """Pieces of a line: a byte with the length, one with the silence before, the bytes."""
    _line(RtuSplitter, data)


def ascii_line(data: bytes) -> None:
    _line(AsciiSplitter, data)


def _line(make: type[RtuSplitter | AsciiSplitter], data: bytes) -> None:
    line = Line(FORMAT)
    for how, piece in _pieces(data):
        line.frame(piece, SILENCES_NS[how % len(SILENCES_NS)])
    events = feed_all(make(FORMAT), line.reads())
    assert raw(events) == line.data, "a byte is in no event"
    assert feed_all(make(FORMAT), line.reads([1] * len(line.data))) == events


def mbap(data: bytes) -> None:
    """A stream of Modbus/TCP or RTU over TCP; the first byte says which, and the direction."""
    direction = Direction.RESPONSE if data[:1] > b"\x7f" else Direction.REQUEST
    make = RtuStreamSplitter if data[:1] and data[0] & 1 else MbapSplitter
    events = whole(make(direction), data[1:])
    assert raw(events) == data[1:], "a byte is in no event"
    assert byte_by_byte(make(direction), data[1:]) == events


def pcap(data: bytes) -> None:
    """A capture file of either kind, decoded."""
    decoder = Decoder(Namer(), any_port=True)
    try:
        for packet in read_capture(io.BytesIO(data)):
            decoder.feed(packet)
    except MbtoolError:
        pass
    decoder.close()


def packets(data: bytes) -> None:
    """Packets: two bytes with the length, one with link type and pause, the bytes."""
    decoder = Decoder(Namer(), ports=(502,), rtu_ports=(5020,), any_port=True)
    now_ns = 0
    for how, piece in _pieces(data, width=2):
        now_ns += how * 1_000_000
        decoder.feed(
            Packet(
                ts_ns=now_ns,
                link="if0",
                data=piece,
                link_type=LINK_TYPES[how % len(LINK_TYPES)],
                original_length=len(piece),
            )
        )
    decoder.close()


def mcap(data: bytes) -> None:
    """A log: all items, the evidence, and its profiles."""
    for read in (LogReader.items, LogReader.evidence):
        try:
            log = LogReader(io.BytesIO(data), "x.mcap")
            for _ in read(log):
                pass
            for profile in log.profiles.values():
                profile_from_json(profile, "x.mcap")
        except MbtoolError:
            continue


def profile(data: bytes) -> None:
    """A profile as TOML, and what is made of it."""
    try:
        made = load_profile(_file(data, "profile.toml"))
    except MbtoolError:
        return
    profile_from_json(profile_to_json(made), "again")


def image(data: bytes) -> None:
    touch = _touch()
    registers = RegisterImage()
    try:
        driven = load_image(Path(_file(data, "image.toml")), touch, registers)
    except MbtoolError:
        return
    for one in driven:
        for at_ns in (0, 1_500_000_000, 86_400_000_000_000):
            one.course(at_ns)


def faults(data: bytes) -> None:
    try:
        FaultFile(Path(_file(data, "faults.toml")), [_touch()])
    except MbtoolError:
        return


def register_list(data: bytes) -> None:
    """A register list as CSV; a profile that is made of it is one that is read."""
    try:
        made = import_register_list(data, "list.csv")
    except MbtoolError:
        return
    load_profile(_file(made.text.encode(), "list.toml"))


def text_log(data: bytes) -> None:
    """A text with frames, or byte times as CSV, decoded; each frame is a whole one."""
    decoder = Decoder(Namer())
    for piece in TextLog(io.BytesIO(data), "x.txt", "x", FORMAT).pieces():
        if isinstance(piece, Chunk) and piece.direction is not Direction.RESPONSE:
            assert whole_frames(piece.data, marked=True), "a request is no frame"
        decoder.feed(piece)
    decoder.close()
    try:
        for chunk in read_byte_times(io.BytesIO(data), "x.csv", "x", None).pieces:
            assert len(chunk.data) == 1
    except MbtoolError:
        pass


def where(data: bytes) -> None:
    try:
        condition = parse_where(data.decode("utf-8", "replace"))
    except MbtoolError:
        return
    assert condition(READ) in (True, False)


def link(data: bytes) -> None:
    """A LINK: what is read of its text, written again, is the same."""
    try:
        spec = parse_link(data.decode("utf-8", "surrogateescape"))
    except MbtoolError:
        return
    assert parse_link(str(spec)) == spec


TARGETS: dict[str, Callable[[bytes], None]] = {
    "rtu": rtu,
    "ascii": ascii_line,
    "mbap": mbap,
    "pcap": pcap,
    "pcapng": pcap,
    "packets": packets,
    "mcap": mcap,
    "profile": profile,
    "image": image,
    "faults": faults,
    "csv": register_list,
    "text-log": text_log,
    "where": where,
    "link": link,
}


def _pieces(data: bytes, width: int = 1) -> Iterator[tuple[int, bytes]]:
    """Cut data into (a byte that says how, bytes); `width` bytes before each say how long."""
    at = 0
    for _ in range(MAX_PACKETS):
        head = data[at : at + width + 1]
        if len(head) <= width:
            return
        length = int.from_bytes(head[:width], "big")
        at += width + 1
        yield head[width], data[at : at + length]
        at += length


@cache
def _touch() -> Profile:
    return load_profile("idec-ft1a-touch")


@cache
def _folder() -> tempfile.TemporaryDirectory[str]:
    place = "/dev/shm" if Path("/dev/shm").is_dir() else None
    return tempfile.TemporaryDirectory(dir=place)


def _file(data: bytes, name: str) -> str:
    path = Path(_folder().name, name)
    path.write_bytes(data)
    return str(path)
