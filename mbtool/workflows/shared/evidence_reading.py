"""Finds, for `convert`, which packets and bytes of a capture belong to which transaction."""

# The files of one capture are read twice. EvidenceReading decodes them and notes which packets and
# bytes each transaction consists of. Then `read_evidence` yields the packets and reads unchanged,
# so that they can be written with these notes.
#
# While decoding, each packet gets a number, and the bytes of a serial line with one tap get their
# position in the line's bytes. So a transaction can name the packets or positions that it came
# from. If two taps hear a line, one the master and one the slaves, there are no positions, and a
# frame is later found by its bytes (wire_streams.py).
#
# Memory: for each frame of a serial line or tap its bytes and its time; for each packet that a
# transaction or finding is about, a number and a text; the first MAX_ERRORS events of the files.

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Sequence
from collections.abc import Set as AbstractSet
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

from mbtool.core import Chunk, Direction, InputError, Origin, Packet, StreamPlace, WireEvent
from mbtool.decode.usb_adapters import UsbAdapters
from mbtool.devices import NamedTransaction, Profile, finding_text
from mbtool.logs import LogReader
from mbtool.modbus import Outcome, Verdict
from mbtool.modbus.response import DamagedAnswers
from mbtool.packets import reads_of, serial_pieces
from mbtool.packets.tcp_ends import TcpEnd, TcpEnds, end_of
from mbtool.packets.usb import USB_LINK_TYPES
from mbtool.sources.files import PACKET_KINDS, CaptureKind, open_capture
from mbtool.workflows.shared.heard_line import serial_types
from mbtool.workflows.shared.read_all import Watch, unwatched
from mbtool.workflows.shared.reading import Reading, ReadingOptions
from mbtool.workflows.shared.wire_streams import SkippedBytes, StreamKey, WireFrame

if TYPE_CHECKING:
    from mbtool.decode.decoder import Decoder, Evidence

_USUAL = (Outcome.OK, Outcome.EXCEPTION, Outcome.BROADCAST, Outcome.MALFORMED)

MAX_ERRORS = 65_536


@dataclass(slots=True)
class EvidenceMarks:
    """The results of decoding a capture that a conversion needs: the frames and packets of its
    transactions, and comments on them.
    """

    frames: dict[StreamKey, list[WireFrame]] = field(default_factory=dict)
    """For serial lines and taps, the frames in each stream of bytes, in the order of the stream.
    The key is the stream's link, direction and TCP connection."""
    skipped: dict[StreamKey, list[SkippedBytes]] = field(default_factory=dict)
    """For each stream of a serial line with one tap: the bytes that belong to no frame, with the
    events about them, in the order of the stream."""
    comments: dict[int, list[str]] = field(default_factory=dict)
    """Comments on packets; the key is the number of the packet, from 1."""
    kept: set[int] = field(default_factory=set)
    """The numbers (from 1) of the packets that contain ADUs of the transactions which the user
    wants."""
    used: set[int] = field(default_factory=set)
    """The numbers (from 1) of all packets that contain ADUs of transactions, wanted or not."""
    kept_damaged: set[tuple[str, int]] = field(default_factory=set)
    """The link and the time (UTC ns) of the frames with a wrong CRC or LRC that were the responses
    to requests which the user wants."""
    spans: dict[str, tuple[int, int]] = field(default_factory=dict)
    """For each serial line, the times (UTC ns) of its first and its last read; the key is the link
    name."""
    transactions: int = 0
    ports: set[int] = field(default_factory=set)
    """The TCP ports of the slaves of all transactions."""
    connections: set[TcpEnds] = field(default_factory=set)
    """The ends of the TCP connections of the transactions which the user wants."""
    devices: dict[TcpEnd | tuple[str, int], str] = field(default_factory=dict)
    """The names, for files, of the slaves of the transactions which the user wants. The key is the
    slave's end, or on a serial line its link and unit."""
    items: int = 0
    """The number of packets and reads that were decoded."""
    errors: list[WireEvent] = field(default_factory=list)
    """The first MAX_ERRORS events that the files themselves have, such as a framing error or a gap
    of a serial line."""


class EvidenceReading(Reading):
    """Decodes a capture, and notes which packets and frames each transaction consists of."""

    def __init__(self, paths: Sequence[str], options: ReadingOptions) -> None:
        super().__init__(paths, options)
        self._types = serial_types(options.line)
        self._usb = UsbAdapters()
        self._positions: defaultdict[str, int] = defaultdict(int)
        self._packets = 0
        self._keys: dict[tuple[str, ...], StreamKey] = {}
        """The key of each stream of bytes that has a known direction. It is found by the link, the
        direction and, for a TCP connection, the addresses of master and slave."""
        self._damaged = DamagedAnswers()
        self.marks = EvidenceMarks()

    def read_marks(
        self, wanted: Callable[[NamedTransaction], bool], first: int = 1, watch: Watch = unwatched
    ) -> None:
        """Decode all files and fill `marks`; the transactions are numbered, and the first one gets
        the number `first`.

        `wanted` returns True for the transactions to keep. Raises InputError for a file that cannot
        be read to its end; then `marks` has what could be read.
        """
        number = first
        try:
            for record in watch(self, self.records()):
                if isinstance(record, WireEvent):
                    self._note_event(record)
                else:
                    self._note_transaction(record, number, is_kept=wanted(record))
                    number += 1
        finally:
            self.marks.transactions = number - first
            for key, frames in self.marks.frames.items():
                if key.direction is Direction.UNKNOWN:
                    frames.sort(key=lambda one: one.begin or 0)
                else:
                    frames.sort(key=lambda one: (one.ts_ns, one.number))

    def _evidence_to_decode(self, items: Iterator[Evidence]) -> Iterator[Evidence]:
        for item in evidence_pieces(items, self._types, self._usb):
            self.marks.items += 1
            if self._decoder is not None:
                self._begin_usb_lines(self._decoder)
            if isinstance(item, Packet):
                self._packets += 1
                yield replace(item, file="", number=self._packets)
            elif isinstance(item, Chunk):
                yield self._placed(item)
            else:
                if isinstance(item, WireEvent) and len(self.marks.errors) < MAX_ERRORS:
                    self.marks.errors.append(item)
                yield item

    def _own_decoder(self) -> Decoder:
        decoder = super()._own_decoder()
        self._begin_usb_lines(decoder)
        return decoder

    def _begin_usb_lines(self, decoder: Decoder) -> None:
        """Give the decoder the settings of USB adapters, which the chunks do not tell."""
        if self._options.line is None:
            for line in self._usb.lines():
                decoder.begin_line(line)

    def _placed(self, chunk: Chunk) -> Chunk:
        key = StreamKey(chunk.link, chunk.direction, chunk.connection)
        if chunk.connection is not None:
            ends = str(chunk.connection.master), str(chunk.connection.slave)
            self._keys[chunk.connection.link, chunk.direction.value, *ends] = key
            return chunk
        begin, end = self.marks.spans.get(chunk.link, (chunk.ts_ns, chunk.ts_ns))
        self.marks.spans[chunk.link] = min(begin, chunk.ts_ns), max(end, chunk.ts_ns)
        if chunk.direction is not Direction.UNKNOWN:
            self._keys[chunk.link, chunk.direction.value] = key
            return chunk
        place = StreamPlace(self._positions[chunk.link], None, Origin("", 0))
        self._positions[chunk.link] += len(chunk.data)
        return replace(chunk, place=place)

    def _note_event(self, event: WireEvent) -> None:
        self._damaged.note(event)
        if event.raw and event.link in self._positions and not event.source:
            key = StreamKey(event.link, Direction.UNKNOWN, None)
            about = SkippedBytes(event.raw, event.kind, event.message, event.ts_ns)
            self.marks.skipped.setdefault(key, []).append(about)

    def _note_transaction(self, one: NamedTransaction, number: int, *, is_kept: bool) -> None:
        marks = self.marks
        about = comments_of(one, self.profile_for(one) if one.findings else None)
        numbers = [each for each in (one.request_packet, one.response_packet) if each]
        marks.used.update(numbers)
        port = (one.destination or "").rpartition(":")[2]
        if port.isdecimal():
            marks.ports.add(int(port))
        damaged_ns = self._damaged.frame_of(one)
        if is_kept:
            marks.kept.update(numbers)
            master, slave = end_of(one.source), end_of(one.destination)
            if slave is not None:
                marks.connections.add(frozenset((slave, master or slave)))
            marks.devices[slave or (one.link, one.unit)] = device_of(one)
            if damaged_ns is not None:
                marks.kept_damaged.add((one.link, damaged_ns))
        if numbers:
            if about:
                marks.comments.setdefault(numbers[-1], []).extend(about)
            return
        for frame in frames_of(one, number, about, is_kept=is_kept):
            direction = Direction.REQUEST if frame.is_request else Direction.RESPONSE
            ends = (one.source, one.destination) if one.source and one.destination else ()
            key = self._keys.get((one.link, direction.value, *ends))
            key = key or StreamKey(one.link, Direction.UNKNOWN, None)
            marks.frames.setdefault(key, []).append(frame)


def device_of(one: NamedTransaction) -> str:
    """Return a name for the file of a slave: its address, or on a serial line its link and unit."""
    return one.slave or f"{one.link}-unit{one.unit}"


def comments_of(one: NamedTransaction, profile: Profile | None) -> list[str]:
    """Return comments on a transaction: its findings, worded for its slave's profile, its verdicts,
    and its outcome if the request or the response is missing.
    """
    return [f"{code}: {finding_text(code, profile)}" for code in one.findings] + remarks_on(one)


def remarks_on(one: NamedTransaction) -> list[str]:
    """Return those comments on a transaction that are no findings: its verdicts, and its outcome if
    the request or the response is missing.
    """
    verdicts = [str(each) for each in one.verdicts if each is not Verdict.AMBIGUOUS]
    texts = [f"verdicts: {', '.join(verdicts)}"] if verdicts else []
    if one.outcome not in _USUAL:
        texts.append(f"outcome: {one.outcome}")
    return texts


def frames_of(
    one: NamedTransaction, number: int, comments: Iterable[str], *, is_kept: bool = True
) -> Iterator[WireFrame]:
    """Yield the frames of a transaction: its request, its response, or both. The last one gets
    `comments`.

    `number` is the number of the transaction. `is_kept` is False if the user does not want the
    transaction.
    """
    sides = []
    if one.request_raw is not None and one.request_ns is not None:
        sides.append((True, one.request_raw, one.request_ns, one.request_offset))
    if one.response_raw is not None and one.response_ns is not None:
        ts_ns = one.response_ns
        if one.latency_ns is not None and one.request_ns is not None:
            ts_ns = one.request_ns + one.latency_ns
        sides.append((False, one.response_raw, ts_ns, one.response_offset))
    for is_request, raw, ts_ns, begin in sides:
        texts = list(comments) if (is_request, raw) == sides[-1][:2] else []
        if Verdict.AMBIGUOUS in one.verdicts:
            taken = "a request" if is_request else "a response"
            texts.append(f"ambiguous: taken for {taken}, confidence {one.confidence:.2f}")
        yield WireFrame(
            raw,
            is_request,
            number,
            one.unit,
            one.transport,
            ts_ns,
            comments=tuple(texts),
            is_kept=is_kept,
            begin=begin,
        )


def evidence_pieces(
    items: Iterable[Evidence], types: AbstractSet[int], usb: UsbAdapters | None = None
) -> Iterator[Evidence]:
    """Yield evidence unchanged, but packets with a link type in `types` and those of USB as the
    chunks of serial bytes that they contain. `usb` learns the settings of USB adapters.
    """
    usb = usb or UsbAdapters()
    for item in items:
        if isinstance(item, Packet) and item.link_type in types:
            yield from serial_pieces(item)
        elif isinstance(item, Packet) and item.link_type in USB_LINK_TYPES:
            yield from usb.feed(item)
        else:
            yield item


def read_evidence(
    paths: Sequence[str], options: ReadingOptions
) -> Iterator[Chunk | Packet | WireEvent]:
    """Yield the packets, chunks and events of the files in order, without decoding them.

    If a file is cut or damaged, yield those before the damage, and raise no error.
    """
    types = serial_types(options.line)
    for path in paths:
        try:
            for item in evidence_pieces(_items(path, options), types):
                if isinstance(item, Chunk | Packet | WireEvent):
                    yield item
        except InputError:
            continue  # Decoding has raised this error before.


def _items(path: str, options: ReadingOptions) -> Iterator[Evidence]:
    with open_capture(path, options.line) as capture:
        if capture.kind is CaptureKind.MCAP:
            yield from LogReader(capture.stream, capture.name).evidence()
        elif capture.kind in PACKET_KINDS:
            yield from reads_of(capture.packets())
        else:
            yield from capture.serial(options.line)[1]
