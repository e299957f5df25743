"""Groups the input files of `convert` by capture, and reads each group as one capture."""

# The parts of a rotated log, and files of packets that follow one another in time, are one capture.
# They are decoded as one, in the order of their part numbers or times, in whatever order the user
# names them. Every other file is a capture of its own.

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import PurePath
from typing import TYPE_CHECKING, NamedTuple

from mbtool.core import Chunk, Direction, InputError, Packet, SerialLink, UsageError, WireEvent
from mbtool.core.evidence import Connection, Endpoint, Stamp
from mbtool.logs import LogReader
from mbtool.logs.transaction_lines import read_jsonl
from mbtool.modbus import Transport
from mbtool.packets import CaptureHead
from mbtool.sources.files import PACKET_KINDS, STANDARD_INPUT, CaptureKind, open_capture, place_of
from mbtool.workflows.shared.capture_parts import BACK_NS, Part
from mbtool.workflows.shared.evidence_reading import EvidenceMarks, EvidenceReading, frames_of
from mbtool.workflows.shared.evidence_reading import read_evidence as evidence_of_files
from mbtool.workflows.shared.read_all import Watch, unwatched
from mbtool.workflows.shared.reading import Reading, ReadingOptions
from mbtool.workflows.shared.wire_streams import StreamKey

if TYPE_CHECKING:
    from mbtool.decode.decoder import Record
    from mbtool.devices import NamedTransaction

JSON_LINES = ".jsonl"
_TABLES = (".parquet", ".csv")


class _InputFile(NamedTuple):
    path: str
    kind: CaptureKind | None
    """The kind of capture; None for a .jsonl file, which contains decoded transactions."""
    part: Part
    first_ns: int
    last_ns: int
    head: CaptureHead


@dataclass(slots=True)
class InputGroup:
    """Input files that together are one capture, and what is known of them."""

    paths: list[str]
    options: ReadingOptions
    head: CaptureHead
    is_log: bool
    """True for logs, and for captures that were made from a log. Such files describe their
    links."""
    is_raw: bool
    """True for logs: their packets and bytes are decoded again, and the transactions stored in them
    are not used."""
    marks: EvidenceMarks = field(default_factory=EvidenceMarks)
    broken: InputError | None = None
    """The error of a file in the group that is cut or damaged. None if there is none, and before
    the files are read."""
    remarks: list[str] = field(default_factory=list)
    line_of: Callable[[str], SerialLink | None] = lambda _: None

    def records(self, watch: Watch = unwatched) -> Iterator[Record]:
        """Yield the transactions and events of the group; those of a log as they are stored
        in it.
        """
        reading = Reading(self.paths, self.options)
        try:
            yield from watch(reading, reading.records())
        except InputError as error:
            self.broken = error
        self.remarks = reading.remarks

    def read_marks(
        self, wanted: Callable[[NamedTransaction], bool], first: int, watch: Watch = unwatched
    ) -> None:
        """Decode the packets and bytes of the group, and set `marks` to the frames, packets and
        comments found.

        `wanted` returns True for the transactions to keep. The transactions are numbered in the
        output; the first one gets the number `first`.
        """
        reading = EvidenceReading(self.paths, replace(self.options, raw=self.is_raw))
        self.line_of = lambda link: reading.line_of(link)
        try:
            reading.read_marks(wanted, first, watch)
        except InputError as error:
            self.broken = error
        self.remarks = reading.remarks
        self.marks = reading.marks

    def evidence(self) -> Iterator[Chunk | Packet | WireEvent]:
        """Yield the packets, chunks and events of the files, without decoding them."""
        return evidence_of_files(self.paths, self.options)


class TransactionGroup(InputGroup):
    """A .jsonl file of transactions. It has no captured packets or bytes, so `evidence` yields the
    request and response bytes that its transactions contain.
    """

    def records(self, watch: Watch = unwatched) -> Iterator[Record]:
        (path,) = self.paths
        with open(path, "rb") as file:
            yield from read_jsonl(file, path)

    def read_marks(
        self, wanted: Callable[[NamedTransaction], bool], first: int, watch: Watch = unwatched
    ) -> None:
        number = first
        for record in self.records():
            if not isinstance(record, WireEvent):
                for frame in frames_of(record, number, (), is_kept=wanted(record)):
                    key = _key_of(record, is_request=frame.is_request)
                    self.marks.frames.setdefault(key, []).append(frame._replace(begin=None))
                number += 1
        self.marks.transactions = number - first
        for key, frames in self.marks.frames.items():
            frames.sort(key=lambda one: (one.ts_ns, one.number, not one.is_request))
            position = 0
            for index, frame in enumerate(frames):
                frames[index] = frame._replace(begin=position)
                position += len(frame.raw)
            if key.connection is None:
                self.marks.spans[key.link] = frames[0].ts_ns, frames[-1].ts_ns

    def evidence(self) -> Iterator[Chunk | Packet | WireEvent]:
        frames = [(key, one) for key, some in self.marks.frames.items() for one in some]
        for key, frame in sorted(frames, key=lambda one: (one[1].ts_ns, one[1].number)):
            yield Chunk(
                ts_ns=frame.ts_ns,
                link=key.link,
                data=frame.raw,
                direction=key.direction,
                stamp=Stamp.LAST_BYTE if key.connection is None else Stamp.AT_ONCE,
                connection=key.connection,
            )


def _key_of(one: NamedTransaction, *, is_request: bool) -> StreamKey:
    master, slave = _endpoint(one.source), _endpoint(one.destination)
    if master is None or slave is None:
        return StreamKey(one.link, Direction.UNKNOWN, None)
    direction = Direction.REQUEST if is_request else Direction.RESPONSE
    is_udp = one.transport in (Transport.UDP, Transport.RTU_UDP)
    return StreamKey(one.link, direction, Connection(master, slave, is_udp=is_udp))


def _endpoint(text: str | None) -> Endpoint | None:
    host, _, port = (text or "").rpartition(":")
    if not host or not port.isdecimal() or int(port) > 0xFFFF:
        return None
    return Endpoint(host.removeprefix("[").removesuffix("]"), int(port))


def grouped(paths: Sequence[str], options: ReadingOptions) -> list[InputGroup]:
    """Group the files by capture; return the groups in the order of their first times.

    Raises InputError for a file that cannot be read. Raises UsageError for a file that is named
    twice, for standard input and pipes, which cannot be read twice, and for a kind that cannot be
    converted.
    """
    known: set[object] = set()
    files: list[_InputFile] = []
    for path in paths:
        place, is_pipe = place_of(path)
        if is_pipe or path == STANDARD_INPUT:
            raise UsageError(f"{path}: convert reads a file twice; save the pipe to a file first")
        if place in known:
            raise UsageError(f"{path}: named twice; what is in it would be there twice")
        known.add(place)
        files.append(_looked_at(path, options, spans=len(paths) > 1))
    files.sort(key=lambda one: (one.part.number or 0, one.first_ns))
    rows: list[list[_InputFile]] = []
    for file in files:
        row = next((row for row in rows if _follows(file, row)), None)
        if row is None:
            rows.append([file])
        else:
            row.append(file)
    rows.sort(key=lambda row: row[0].first_ns)
    return [_group(row, options) for row in rows]


def _follows(file: _InputFile, row: list[_InputFile]) -> bool:
    last = row[-1]
    if file.kind is CaptureKind.MCAP:
        return last.kind is CaptureKind.MCAP and file.part.follows(last.part)
    is_plain = file.kind in PACKET_KINDS and not file.head.capture
    is_like = last.kind in PACKET_KINDS and not last.head.capture
    return is_plain and is_like and file.first_ns >= last.last_ns - BACK_NS


def _group(row: list[_InputFile], options: ReadingOptions) -> InputGroup:
    first = row[0]
    kind = InputGroup if first.kind is not None else TransactionGroup
    is_log = bool(first.head.capture)
    is_raw = first.kind is CaptureKind.MCAP
    return kind([one.path for one in row], options, first.head, is_log or is_raw, is_raw)


def _looked_at(path: str, options: ReadingOptions, *, spans: bool) -> _InputFile:
    suffix = PurePath(path).suffix.lower()
    if suffix == JSON_LINES:
        return _InputFile(path, None, Part(), _first_of_lines(path), 0, CaptureHead())
    try:
        capture = open_capture(path, options.line)
    except InputError:
        if suffix in _TABLES:
            raise InputError(
                f"{path}: a table of transactions is not converted back; convert the capture, "
                "the log or the .jsonl that it was made from"
            ) from None
        raise
    with capture:
        if capture.kind is CaptureKind.MCAP:
            if options.line is not None:
                raise UsageError(f"{path}: --link is not for a log, which has its lines' settings")
            log = LogReader(capture.stream, capture.name)
            head = CaptureHead(
                capture=dict(log.capture),
                links={name: dict(one) for name, one in log.links.items()},
                devices=dict(log.devices),
                profiles=dict(log.profiles),
            )
            part = Part.of_log(log)
            with suppress(InputError):
                for item in log.items():
                    first_ns = item.ts_ns if not hasattr(item, "start_ns") else item.start_ns
                    return _InputFile(path, capture.kind, part, first_ns, 0, head)
            return _InputFile(path, capture.kind, part, 0, 0, head)
        first_ns = last_ns = 0
        if capture.kind in PACKET_KINDS:
            with suppress(InputError):
                for packet in capture.packets():
                    first_ns = first_ns or packet.ts_ns
                    last_ns = max(last_ns, packet.ts_ns)
                    if not spans:
                        break
            return _InputFile(
                path, capture.kind, Part(), first_ns, last_ns, capture.head or CaptureHead()
            )
        with suppress(InputError):
            for piece in capture.serial(options.line)[1]:
                first_ns = piece.ts_ns
                break
        return _InputFile(path, capture.kind, Part(), first_ns, 0, CaptureHead())


def _first_of_lines(path: str) -> int:
    try:
        with open(path, "rb") as file:
            for record in read_jsonl(file, path):
                return record.ts_ns if isinstance(record, WireEvent) else record.start_ns
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from error
    return 0
