"""Turns a recording into the bytes to send to a serial line: those of the master and the slaves."""

# A recording of a serial line is sent byte by byte as it was captured, with the silences between
# reads. A read has the time of its last byte, so its first byte began as many character times
# earlier as the read has bytes. A silence of at least t3.5 is never shortened below t3.5, however
# fast the recording is played.
#
# A recording of a network is sent as transactions: each PDU is framed for the serial line. A
# response is sent right after its request. The next request is sent after the response, even if the
# recorded master did not wait for the response, because a serial line carries one transaction at a
# time.
#
# Only one line can be played; --where 'link == ...' chooses it. Other conditions of --where apply
# only to transactions recorded on a network: the bytes of a serial line are always all sent.

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import TYPE_CHECKING, NamedTuple

from mbtool.core import (
    Chunk,
    CutError,
    DamageError,
    InputError,
    LineSettings,
    SerialFormat,
    SerialLink,
    Stamp,
    UsageError,
    WireEvent,
    parse_link,
)
from mbtool.decode.usb_adapters import UsbAdapters
from mbtool.logs import LogReader
from mbtool.logs.links import SPEC
from mbtool.modbus import ascii_adu, rtu_adu, whole_pdu
from mbtool.packets import CaptureHead, LinePacket, serial_pieces
from mbtool.packets.usb import USB_LINK_TYPES
from mbtool.replay import ByteRun
from mbtool.sources.files import PACKET_KINDS, STANDARD_INPUT, CaptureKind, open_capture
from mbtool.workflows.shared.heard_line import serial_types
from mbtool.workflows.shared.read_all import Watch, unwatched
from mbtool.workflows.shared.recorded import PlayOptions, read_recorded, where_none

if TYPE_CHECKING:
    from mbtool.devices import NamedTransaction
    from mbtool.workflows.shared.reading import ReadingOptions

MAX_PIECE = 256
"""At most this many bytes are passed to a serial port at once, so that the port takes them without
waiting. It is the length of the longest RTU ADU."""


class Begun(NamedTuple):
    """Bytes to send. The first one begins at `begin_ns` (UTC ns); `after_silence` is True if a
    silence of at least t3.5 precedes them.
    """

    begin_ns: int
    data: bytes
    after_silence: bool


def read_pieces(
    path: str,
    options: PlayOptions,
    link: SerialLink,
    on_remark: Callable[[str], None],
    watch: Watch = unwatched,
) -> list[ByteRun]:
    """Return the pieces of bytes to send, in order of time.

    Their times count from the beginning of the played part, in ns of recorded time. `link` is the
    line to play on. `on_remark` gets lines for the user about the file. Raises InputError if the
    file cannot be read or has nothing to send. Raises UsageError if it has several lines, or a line
    of another mode (RTU or ASCII) than `link`.
    """
    window = options.window
    transactions = read_recorded(path, options, on_remark, watch).transactions
    lines = {one.link for one in transactions if one.transport.is_serial}
    _demand_one_line(path, lines, transactions)
    if lines:
        begun = _begun_on_line(path, options.reading, lines.pop(), link, on_remark)
    else:
        begun = _begun_frames(transactions, is_ascii=link.ascii)
        if any(one.unit == 0 and one.response_raw is not None for one in transactions):
            on_remark(
                f"{path}: unit 0 answers in it, but on a serial line unit 0 is a broadcast: "
                "listeners take its responses for unsolicited ones"
            )
    first_ns = begun[0].begin_ns if begun else 0
    pieces = [
        ByteRun(one.begin_ns - first_ns - window.start_ns, one.data, one.after_silence)
        for one in begun
        if one.begin_ns - first_ns in window
    ]
    if not pieces:
        raise InputError(f"{path}: nothing to play{where_none(window)}")
    return pieces


def _demand_one_line(path: str, lines: set[str], transactions: list[NamedTransaction]) -> None:
    others = {one.link for one in transactions} - lines
    if len(lines) > 1 or (lines and others):
        few = sorted(lines)
        more = f" and {len(others)} of a network" if others else ""
        raise UsageError(
            f"{path}: has several lines ({', '.join(few[:4])}{more}), and a bus is one; "
            f"choose it with --where 'link == \"{few[0]}\"'"
        )


def _begun_frames(transactions: Iterable[NamedTransaction], *, is_ascii: bool) -> list[Begun]:
    adu = ascii_adu if is_ascii else rtu_adu
    begun: list[Begun] = []
    last_ns = 0
    for one in sorted(transactions, key=lambda each: each.start_ns):
        for at_ns, raw in ((one.request_ns, one.request_raw), (one.response_ns, one.response_raw)):
            pdu = whole_pdu(one.transport, raw)
            if at_ns is not None and pdu is not None:
                last_ns = max(last_ns, at_ns)
                begun.append(Begun(last_ns, adu(one.unit, pdu), after_silence=True))
    return begun


def _begun_on_line(
    path: str,
    options: ReadingOptions,
    name: str,
    link: SerialLink,
    on_remark: Callable[[str], None],
) -> list[Begun]:
    """Return the bytes of the recorded serial line `name` in order of time.

    `on_remark` gets a line for the user if the bytes have no times. Raises UsageError if the line
    has another mode (RTU or ASCII) than `link`, on which it is to be played.
    """
    if path == STANDARD_INPUT:
        raise UsageError("standard input: a recording of a serial line is read twice; name a file")
    pieces: list[_Heard] = []
    untimed = False
    try:
        for line, chunk in _evidence(path, options):
            if chunk.link != name:
                continue
            if line.ascii != link.ascii:
                right = f"{'ascii' if line.ascii else 'rtu'}:{link.port}@{line.format}"
                raise UsageError(f"{path}: was recorded as {line}; play it on {right}")
            untimed = untimed or chunk.stamp is Stamp.UNKNOWN
            pieces += _cut_chunk(chunk, line.format)
    except (CutError, DamageError):
        pass  # `read_recorded` has already told the user that the file is cut or damaged.
    if untimed:
        on_remark(f"{path}: has no times of its bytes: they are sent without a silence")
    # Sort by the time of the last byte, which is known. The time of the first byte is computed from
    # the baud rate. If the assumed baud rate is too low, a long piece would seem to begin before
    # the piece before it.
    pieces.sort(key=lambda one: one.end_ns)
    begun: list[Begun] = []
    end_ns: int | None = None
    for one in pieces:
        begin_ns = one.begin_ns if end_ns is None else max(one.begin_ns, begun[-1].begin_ns)
        silent = end_ns is None or one.begin_ns - end_ns >= one.silence_ns
        begun.append(Begun(begin_ns, one.data, silent))
        end_ns = one.end_ns
    return begun


class _Heard(NamedTuple):
    """Captured bytes. The first one began at `begin_ns` and the last one ended at `end_ns` (UTC
    ns); `silence_ns` is t3.5 of their line in ns.
    """

    begin_ns: int
    end_ns: int
    data: bytes
    silence_ns: int


def _cut_chunk(chunk: Chunk, line: SerialFormat) -> Iterator[_Heard]:
    """Cut a chunk into pieces of at most MAX_PIECE bytes, each with its own times."""
    character_ns = line.character_ns
    begin_ns = chunk.ts_ns
    if chunk.stamp is not Stamp.AT_ONCE:
        begin_ns -= len(chunk.data) * character_ns
    for start in range(0, len(chunk.data), MAX_PIECE):
        data = chunk.data[start : start + MAX_PIECE]
        at_ns = begin_ns + start * character_ns
        yield _Heard(at_ns, at_ns + len(data) * character_ns, data, line.t3_5_ns)


def _evidence(path: str, options: ReadingOptions) -> Iterator[tuple[LineSettings, Chunk]]:
    """Yield the chunks of serial lines in a file, without decoding them, each with the settings of
    its line.
    """
    given = options.line or LineSettings(SerialFormat())
    with open_capture(path, options.line) as capture:
        if capture.kind is CaptureKind.MCAP:
            log = LogReader(capture.stream, capture.name)
            lines: dict[str, LineSettings | None] = {}
            for item in log.evidence():
                if item.link not in lines:  # A log may describe a link just before its first item.
                    lines[item.link] = _settings(log.links.get(item.link, {}).get(SPEC))
                line = lines[item.link]
                if isinstance(item, Chunk) and line is not None:
                    yield line, item
        elif capture.kind in PACKET_KINDS:
            types = serial_types(options.line)
            usb = UsbAdapters()
            for packet in capture.packets():
                shown: Sequence[Chunk | WireEvent] = ()
                if isinstance(packet, LinePacket):
                    shown = packet.chunks
                elif packet.link_type in types:
                    shown = serial_pieces(packet)
                elif packet.link_type in USB_LINK_TYPES:
                    shown = usb.feed(packet)
                for piece in shown:
                    line = _line_in(capture.head, piece.link) if capture.head else given
                    if options.line is None and (known := usb.settings(piece.link)) is not None:
                        line = known
                    if isinstance(piece, Chunk) and line is not None:
                        yield line, piece
        else:
            settings, pieces = capture.serial(options.line)
            for read in pieces:
                if isinstance(read, Chunk):
                    yield settings, read


def _line_in(head: CaptureHead, link: str) -> LineSettings | None:
    """The settings of the line with this link name, in a capture whose head describes its links;
    None if the link is no serial line.
    """
    return _settings(head.links.get(link, {}).get(SPEC))


def _settings(spec: str | None) -> LineSettings | None:
    """The settings in a LINK text such as `rtu:COM3@9600`; None if `spec` is None or names no
    serial line.
    """
    link = None if spec is None else parse_link(spec)
    return LineSettings(link.format, link.ascii) if isinstance(link, SerialLink) else None
