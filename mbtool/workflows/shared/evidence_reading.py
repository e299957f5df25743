"""Reads the evidence of captures, and what decoding says of each packet and frame."""

# What is read belongs together: one file, or the parts of one capture. It is read twice: first it
# is decoded, which says what each packet and each frame is, then its packets and reads are given.
#
# In the first reading each packet gets a number, and each byte of a serial line with one tap its
# place, so that a transaction names the packets and places that it came from. For links with a tap
# on each side the frames are found by their bytes.
#
# Memory: for each frame of a serial line or tap its bytes and its time; for each packet that a
# transaction or finding is about, a number and a text.

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

from mbtool.core import Chunk, Direction, InputError, Origin, Packet, StreamPlace, WireEvent
from mbtool.devices import finding_text
from mbtool.logs import LogReader
from mbtool.modbus import Outcome, Verdict
from mbtool.packets import reads_of, serial_pieces
from mbtool.sources.files import PACKET_KINDS, CaptureKind, open_capture
from mbtool.workflows.shared.heard_line import serial_types
from mbtool.workflows.shared.read_all import unwatched
from mbtool.workflows.shared.reading import Reading
from mbtool.workflows.shared.wire_streams import SkippedBytes, StreamKey, WireFrame

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Sequence
    from collections.abc import Set as AbstractSet

    from mbtool.decode.decoder import Evidence
    from mbtool.devices import NamedTransaction, Profile
    from mbtool.workflows.shared.read_all import Watch
    from mbtool.workflows.shared.reading import ReadingOptions


@dataclass(slots=True)
class EvidenceMarks:
    """What decoding says of packets and frames."""

    frames: dict[StreamKey, list[WireFrame]] = field(default_factory=dict)
    """The frames of each stream of a serial line or a tap, in the order of the line."""
    skipped: dict[StreamKey, list[SkippedBytes]] = field(default_factory=dict)
    """The events about bytes of a serial line with one tap, in the order of the line."""
    comments: dict[int, list[str]] = field(default_factory=dict)
    """Comments for packets, by the packet's number."""
    kept: set[int] = field(default_factory=set)
    """The numbers of the packets with ADUs of wanted transactions."""
    used: set[int] = field(default_factory=set)
    """The numbers of all packets with ADUs."""
    spans: dict[str, tuple[int, int]] = field(default_factory=dict)
    """For each serial line, the times of its first and its last read in UTC ns."""
    transactions: int = 0


class EvidenceReading(Reading):
    """Decodes evidence once, and notes what it says of packets and frames."""

    def __init__(self, paths: Sequence[str], options: ReadingOptions) -> None:
        super().__init__(paths, options)
        self._types = serial_types(options.line)
        self._positions: defaultdict[str, int] = defaultdict(int)
        self._packets = 0
        self._keys: dict[tuple[str, ...], StreamKey] = {}
        """The streams with a direction, by link, direction and ends."""
        self.marks = EvidenceMarks()

    def read_marks(
        self, wanted: Callable[[NamedTransaction], bool], first: int = 1, watch: Watch = unwatched
    ) -> None:
        """Decode all; `first` is the number of the first transaction.

        Raises the errors of `records`; what was read before is noted.
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

    def _fed(self, items: Iterator[Evidence]) -> Iterator[Evidence]:
        for item in evidence_pieces(items, self._types):
            if isinstance(item, Packet):
                self._packets += 1
                yield replace(item, file="", number=self._packets)
            elif isinstance(item, Chunk):
                yield self._placed(item)
            else:
                yield item

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
        if event.raw and event.link in self._positions and not event.source:
            key = StreamKey(event.link, Direction.UNKNOWN, None)
            about = SkippedBytes(event.raw, event.kind, event.message, event.ts_ns)
            self.marks.skipped.setdefault(key, []).append(about)

    def _note_transaction(self, one: NamedTransaction, number: int, *, is_kept: bool) -> None:
        marks = self.marks
        about = comments_of(one, self.profile_for(one) if one.findings else None)
        numbers = [each for each in (one.request_packet, one.response_packet) if each]
        marks.used.update(numbers)
        if is_kept:
            marks.kept.update(numbers)
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


def comments_of(one: NamedTransaction, profile: Profile | None) -> list[str]:
    """The findings of a transaction, in the words of its slave's profile, and what else there is to
    remark.
    """
    return [f"{code}: {finding_text(code, profile)}" for code in one.findings] + remarks_on(one)


def remarks_on(one: NamedTransaction) -> list[str]:
    """What the decoder remarks on a transaction, beside its findings."""
    verdicts = [str(each) for each in one.verdicts if each is not Verdict.AMBIGUOUS]
    texts = [f"verdicts: {', '.join(verdicts)}"] if verdicts else []
    if one.outcome in (Outcome.NO_ANSWER, Outcome.NOT_CAPTURED, Outcome.UNSOLICITED):
        texts.append(f"outcome: {one.outcome}")
    return texts


def frames_of(
    one: NamedTransaction, number: int, comments: Iterable[str], *, is_kept: bool = True
) -> Iterator[WireFrame]:
    """The frames of a transaction; the last one has the comments."""
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


def evidence_pieces(items: Iterable[Evidence], types: AbstractSet[int]) -> Iterator[Evidence]:
    """The evidence, with the bytes of a serial line in place of packets that hold them."""
    for item in items:
        if isinstance(item, Packet) and item.link_type in types:
            yield from serial_pieces(item)
        else:
            yield item


def read_evidence(
    paths: Sequence[str], options: ReadingOptions
) -> Iterator[Chunk | Packet | WireEvent]:
    """Give the packets and reads of files in their order, up to the first damage of each file."""
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
            yield from capture.serial(options.line).pieces
