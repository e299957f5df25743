"""Reads captures and logs of any kind into named transactions and events."""

# A packet capture is decoded. A file with the bytes of a serial line is decoded as one line. From a
# log, the stored transactions and events are read; with the option `raw` its packets and bytes are
# decoded again, with the line settings and profiles in the log, unless the user gives others. If
# some packets or bytes in a log were not decoded, all logs are decoded again (undecoded_logs.py).
#
# Files that are parts of one capture (capture_parts.py), named in their order, are decoded as one,
# since a connection may begin in one part and end in the next. If a part is cut or damaged, a GAP
# event is yielded between its records and those of the next part.
#
# InputError is raised for a file that cannot be read: at once, or, if demand_files() has already
# found it, after the records of the other files. If a file is cut (CutError) or damaged
# (DamageError), the first such error is raised after all other records.

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import chain, islice
from typing import TYPE_CHECKING

from msgspec.structs import replace

from mbtool.core import (
    Chunk,
    EventKind,
    InputError,
    Packet,
    SerialFormat,
    SerialLink,
    UsageError,
    WireEvent,
)
from mbtool.core.limits import MODBUS_PORT
from mbtool.core.moments import counted
from mbtool.decode.line_timing import LineTiming
from mbtool.devices import Assignments, NamedTransaction, Namer, Profile
from mbtool.logs import LogReader
from mbtool.logs.links import (
    ACROSS,
    PORTS,
    RTU_PORTS,
    LinkMetadata,
    all_assignments,
    names_any_port,
    ports_of,
    serial_lines,
)
from mbtool.logs.rotation import with_parts
from mbtool.packets import reads_of, serial_pieces
from mbtool.sources.files import (
    PACKET_KINDS,
    TIMED_KINDS,
    CaptureKind,
    open_capture,
    place_of,
)
from mbtool.workflows.shared.capture_parts import MissingParts, Part, Seam
from mbtool.workflows.shared.file_results import FileResults
from mbtool.workflows.shared.heard_line import HeardLine, heard_remarks, serial_types
from mbtool.workflows.shared.log_records import log_records
from mbtool.workflows.shared.reading_options import ReadingOptions
from mbtool.workflows.shared.undecoded_logs import LogRemarks, evidence_and_events

if TYPE_CHECKING:
    from mbtool.decode.decoder import Decoder, Evidence, Record
    from mbtool.sources.byte_files import SerialPiece
    from mbtool.sources.files import CaptureFile
    from mbtool.workflows.shared.unreadable_lines import LineOf

# The code below decides for which serial lines the recorded times of bytes are exact.
#
# A file with a time for each byte comes from a logic analyser, whose times are exact, or from a
# program that noted when it read each byte. On a wire a byte ends at least one character time after
# the byte before it. A program now and then reads several bytes at once, and so notes nearly the
# same time for them. So the times of a line count as exact if at most MAX_NEAR_SHARE of its bytes
# come less than MIN_CHARACTERS after the byte before.
#
# Memory: three numbers for each line.

MIN_CHARACTERS = 0.9
"""The shortest plausible time from the end of one byte to the end of the next, in character times.
It is below 1, as the clocks of senders and analysers are a few percent fast or slow."""
MAX_NEAR_SHARE = 0.01
"""A line's times are exact only if at most this share (0 to 1) of its bytes come less than
MIN_CHARACTERS after the byte before. Some may, because a disturbance on the wire can look like a
byte."""


@dataclass(slots=True)
class _LineBytes:
    heard: int = 0
    near: int = 0


class ExactTimes:
    """Counts the bytes of each serial line that come too soon after the byte before them, and so
    decides whether the line's times are exact.
    """

    def __init__(self) -> None:
        self._lines: dict[str, _LineBytes] = {}

    def noted(self, pieces: Iterator[SerialPiece], line: SerialFormat) -> Iterator[SerialPiece]:
        """Yield chunks of one byte each, all of a line with the format `line`, and count those that
        come too soon.
        """
        least_ns = MIN_CHARACTERS * line.character_ns
        last_ns = -(1 << 63)
        for piece in pieces:
            if not isinstance(piece, Chunk):
                yield piece
                continue
            noted = self._lines.setdefault(piece.link, _LineBytes())
            noted.heard += 1
            noted.near += piece.ts_ns - last_ns < least_ns
            last_ns = piece.ts_ns
            yield piece

    def is_exact(self, link: str) -> bool:
        """True if the byte times of the line with this link name are exact, as far as they were
        read; False if none were read.
        """
        noted = self._lines.get(link)
        return noted is not None and noted.near <= MAX_NEAR_SHARE * noted.heard


_SERIAL_KINDS = frozenset(CaptureKind) - PACKET_KINDS - {CaptureKind.MCAP}
UNDECODABLE_EVENTS = frozenset((EventKind.UNREADABLE, EventKind.CUT))


__all__ = ["MODBUS_PORT", "UNDECODABLE_EVENTS", "Reading", "ReadingOptions"]


class Reading:
    """Reads files once, and yields their transactions and events."""

    def __init__(self, paths: Sequence[str], options: ReadingOptions) -> None:
        """`paths` are files; the name of a log that was rotated stands for all of its parts."""
        self._paths = paths = with_parts(paths)
        self._options = options
        self._current: CaptureFile | None = None
        self._decoder: Decoder | None = None
        """The decoder for all files of the current capture; None before its first item."""
        self._part: Part | None = None
        self._seam = Seam()
        self._items = 0
        """The number of items decoded so far: packets, serial reads, events of ports or taps."""
        self._serial_packets = 0
        """The number of packets read so far that contain bytes of a serial line."""
        self._has_found = False
        """True once a transaction or event was found in the files."""
        self._foreign = 0
        """The number of events that tell of connections with another protocol."""
        self._has_decoded = False
        """True once a transaction was found, or an event that does not report undecodable data."""
        self._first_undecodable: str | None = None
        """The message of the first event about undecodable data; None if there was none."""
        self._heard: list[HeardLine] = []
        """A check of the assumed baud rate, for each file of packets that has serial bytes."""
        self._missing = MissingParts()
        self._logs = LogRemarks(paths, is_raw=options.raw)
        self.results = FileResults(paths)
        self._misordered: list[str] = []
        self._of_texts: list[str] = []
        """For each text with frames, a line that says how many it has."""
        self._kinds: set[CaptureKind] = set()
        self._last_ns = 0
        """The time (UTC ns) of the last transaction or event that was yielded."""
        self._ports: tuple[Sequence[int], Sequence[int]] = (
            options.ports or (MODBUS_PORT,),
            options.rtu_ports,
        )
        self._any_port = options.any_port
        self.assignments = options.assignments
        """The profiles in use: those that the user gave, and those in the log being read."""
        self.exact_times = ExactTimes()
        """Tells which serial lines have exact byte times; final at the end of a line's file."""
        self.captures = 0
        """The number of captures that ended before the last record. Files that are parts of one
        capture, as from `sniff --rotate`, count as one."""
        self.file = ""
        """The name of the file that the last transaction or event came from."""
        self.is_log = False
        """True if the last transaction or event was stored in a log, and was not decoded again."""
        self.format_of: Callable[[str], SerialFormat | None] = lambda _: None
        """A function that returns the baud rate and character format of a serial line, given its
        link name. It returns None if they are unknown, or if the line's bytes have no times."""
        self.line_of: LineOf = lambda _: None
        """A function that returns the serial line with a link name; None if the name is unknown."""

    def profile_for(self, transaction: NamedTransaction) -> Profile | None:
        return self.assignments.profile_for(transaction)

    def profile_named(self, name: str) -> Profile | None:
        """Return the profile in use that has this name; None if there is none."""
        return next((one for one in self.assignments.profiles if one.name == name), None)

    @property
    def fraction(self) -> float | None:
        """The share (0 to 1) of the files read so far; None if it is unknown, as for a pipe."""
        part = self._current.fraction() if self._current is not None else 0.0
        return None if part is None else (self.results.files_read + part) / len(self._paths)

    @property
    def progress_text(self) -> str:
        """A text for a progress bar about the file that is being read: `file 3 of 60`."""
        return f"file {min(self.results.files_read + 1, len(self._paths))} of {len(self._paths)}"

    @property
    def noun(self) -> str:
        return "transactions"

    @property
    def why_empty(self) -> str | None:
        """A line for the user that says why the files have no transaction, and no event but such
        about connections with other protocols.

        None if they have some, or if they are not read to their ends.
        """
        if self._has_found or not self._is_complete:
            return None
        names = self.results.names
        if not self._items and not self._kinds <= _SERIAL_KINDS:
            return f"{names}: empty; there is neither a packet nor a transaction in it"
        if self._items == self._serial_packets:
            return f"{names}: no byte of a serial line in it"
        others = f"; {counted(self._foreign, 'server', ',')} with other protocols"
        if self._any_port:
            return f"{names}: no Modbus at any TCP port{others if self._foreign else ''}"
        ports = {port for some in self._ports for port in some}
        return (
            f"{names}: no Modbus at TCP port {', '.join(map(str, sorted(ports)))}; "
            "--port any looks at all ports, --port N and for RTU over TCP --rtu-port N at some"
        )

    def demand_readable(self) -> None:
        """Raise InputError if the files were read, and have only events about undecodable data."""
        why = self._first_undecodable
        if why is not None and not self._has_decoded and self._is_complete:
            raise InputError(f"{self.results.names}: nothing in it could be read: {why}")

    @property
    def _current_name(self) -> str:
        return self._current.name if self._current is not None else ""

    @property
    def _is_complete(self) -> bool:
        return self.results.files_read == len(self._paths)

    @property
    def remarks(self) -> list[str]:
        """Lines for the user about the files, such as cut packets or options without effect."""
        remarks = heard_remarks(self._heard, is_named=self._options.line is not None)
        remarks += self._missing.remarks
        kinds = self._kinds
        if self._options.raw and kinds and CaptureKind.MCAP not in kinds:
            remarks.append("--raw has no effect: it is for logs (.mcap), and there is none")
        if self._options.line is not None and set() < kinds <= PACKET_KINDS and not self._heard:
            remarks.append("--link has no effect: these are packets of a network")
        if self._has_found and self._is_complete:
            remarks += self._options.assignments.remarks
        return (
            remarks + self._of_texts + self._misordered + self._logs.remarks + self.results.table()
        )

    def demand_files(self) -> None:
        """Check that the files exist, are named once, and are of a kind that can be read.

        A pipe is not opened, as it can be read only once. A file that is missing or of another kind
        is left out. Raises InputError if that leaves no file, and UsageError for a file that is
        named twice or does not fit the options.
        """
        known: set[object] = set()
        for path in self._paths:
            try:
                self._demand_file(path, known)
            except InputError as error:
                self.results.refuse(path, error)
        if len(self.results.refused) == len(self._paths):
            raise self.results.refused[self._paths[0]]

    def _demand_file(self, path: str, known: set[object]) -> None:
        """Check one file; raise UsageError if it is in `known`, the files so far, else add it."""
        place, is_pipe = place_of(path)
        if not is_pipe:
            with open_capture(path, self._options.line) as capture:
                self._demand_line_is_open(capture)
        if place in known:
            raise UsageError(f"{path}: named twice; what is in it would count twice")
        known.add(place)

    def records(self) -> Iterator[Record]:
        """Yield all transactions and events, file by file. Each transaction names its file."""
        for record in self._records():
            if isinstance(record, WireEvent) and record.kind is EventKind.FOREIGN:
                self._foreign += 1
            else:
                self._has_found = True
            self.results.note(self.file, record)
            if not isinstance(record, WireEvent):
                if record.verdicts:  # Without any, no call is needed.
                    self._missing.note_record(record)
                self._last_ns = record.start_ns
                self._has_decoded = True
                yield replace(record, file=self.file) if record.file is None else record
                continue
            self._missing.note_record(record)
            self._last_ns = record.ts_ns
            if record.kind in UNDECODABLE_EVENTS:
                self._first_undecodable = self._first_undecodable or record.message
            else:
                self._has_decoded = True
            yield record

    def _records(self) -> Iterator[Record]:
        return self.results.in_turn(self._file_records, self._break_off, self._end_capture)

    def _file_records(self, path: str) -> Iterator[Record]:
        with open_capture(path, self._options.line) as capture:
            self._current = capture
            self._kinds.add(capture.kind)
            if capture.kind is CaptureKind.MCAP:
                yield from self._log_records(capture)
            elif capture.kind in PACKET_KINDS:
                yield from self._packet_records(capture)
            else:
                yield from self._serial_records(capture)
                if capture.remark is not None:
                    self._of_texts.append(capture.remark)

    def _packet_records(self, capture: CaptureFile) -> Iterator[Record]:
        packets = capture.packets()
        first = list(islice(packets, 1))
        packets = chain(first, packets)
        head = capture.head
        if head is None:
            return self._decode_file(
                self._heard_packets(capture, packets), Part(), self._own_decoder
            )
        self.results.note_head(capture.name, head)
        self.assignments = all_assignments(head, self._options.assignments)
        return self._decoded_again(head, reads_of(packets), Part(0))

    def _break_off(self, error: InputError) -> Iterator[Record]:
        """Yield a GAP event for a cut or damaged file: data is missing before the next file."""
        is_of_packets = self._part is not None and self._part.number is None
        gap = WireEvent(ts_ns=self._last_ns, link="", kind=EventKind.GAP, message=str(error))
        if self._decoder is None:
            yield gap
        elif is_of_packets:
            yield from self._decoder.break_lines()
            yield gap
        else:
            yield from self._decoder.feed(gap)

    def _timing(self, assignments: Assignments) -> LineTiming:
        options = self._options
        return LineTiming(assignments, options.t1_5, options.t3_5, options.response_timeout)

    def _own_decoder(self) -> Decoder:
        """Create a decoder, from the user's options, for a file that lacks its links' settings."""
        from mbtool.decode.decoder import Decoder

        options = self._options
        return Decoder(
            Namer(options.assignments),
            line=options.line,
            timing=self._timing(options.assignments),
            ports=options.ports or (MODBUS_PORT,),
            rtu_ports=options.rtu_ports,
            any_port=options.any_port,
            across=True,  # Several interfaces of the file may have captured one connection.
        )

    def _serial_records(self, capture: CaptureFile) -> Iterator[Record]:
        yield from self._end_capture()
        line, pieces = capture.serial(self._options.line)
        if capture.kind in TIMED_KINDS:
            pieces = self.exact_times.noted(pieces, line.format)
        decoder = self._decoder = self._own_decoder()
        self.format_of, self.line_of = decoder.format_of, decoder.line_of
        decoder.begin_line(line.link_at(capture.link))
        for piece in self._evidence_to_decode(pieces):
            self._items += 1
            yield from decoder.feed(piece)
        yield from self._end_capture()

    def _evidence_to_decode(self, items: Iterator[Evidence]) -> Iterator[Evidence]:
        """Return the items to decode; a subclass may override this to see or change them."""
        return items

    def _heard_packets(self, capture: CaptureFile, packets: Iterator[Packet]) -> Iterator[Packet]:
        """Yield the packets unchanged. Count those with bytes of a serial line, and use these to
        check whether the assumed baud rate is too low.
        """
        types = serial_types(self._options.line)
        heard: HeardLine | None = None
        for packet in packets:
            if packet.link_type in types:
                self._serial_packets += 1
                heard = heard or self._hear(capture)
                for piece in serial_pieces(packet):
                    heard.note(piece)
            yield packet

    def _hear(self, capture: CaptureFile) -> HeardLine:
        line = self._options.line
        heard = HeardLine(capture.name, SerialFormat() if line is None else line.format)
        self._heard.append(heard)
        return heard

    def _demand_line_is_open(self, capture: CaptureFile) -> None:
        if capture.kind is CaptureKind.MCAP and self._options.line is not None:
            raise UsageError(
                f"{capture.name}: --link is not for a log, which has the settings of its lines; "
                "to change their silences use --raw with --t3-5"
            )

    def _decode_file(
        self, evidence: Iterator[Evidence], part: Part, begin: Callable[[], Decoder]
    ) -> Iterator[Record]:
        """Decode a file with the decoder of the file before, if both are of the same capture; else
        end that capture, and decode with a new decoder from `begin`.
        """
        if not part.follows(self._part):
            yield from self._end_capture()
        self._part = part
        is_first = True
        for item in self._evidence_to_decode(evidence):
            if is_first and not self._seam.is_continued_by(item):
                self._note_order(item)
                yield from self._end_capture()
                self._part = part
            if is_first:
                self._enter()
            is_first = False
            if self._decoder is None:
                self._decoder = begin()
                self.format_of = self._decoder.format_of
                self.line_of = self._decoder.line_of
            self._items += 1
            self._missing.note_item(item)
            self._seam.note(item)
            yield from self._decoder.feed(item)

    def _note_order(self, item: Evidence) -> None:
        """Tell the user once that the file with the first item `item` is named in wrong order."""
        if self._seam.is_overtaken_by(item) and not self._misordered:
            self._misordered.append(
                f"{self._current_name}: begins before "
                f"{self.file} ends, so it is read as another capture; "
                "name the parts of one capture in the order of their times"
            )

    def _end_capture(self) -> Iterator[Record]:
        """End the capture: yield the transactions and events that its decoder still holds."""
        decoder, self._decoder = self._decoder, None
        self._part, self._seam = None, Seam()
        if decoder is not None:
            yield from decoder.close()
        self.captures += 1
        self._enter()

    def _enter(self, *, is_log: bool = False) -> None:
        """Set `file` and `is_log` for the next records, which the file open now contains."""
        self.file = self._current_name
        self.is_log = is_log

    def _log_records(self, capture: CaptureFile) -> Iterator[Record]:
        self._demand_line_is_open(capture)
        log = LogReader(capture.stream, capture.name)
        self.results.note_head(capture.name, log)
        if self._options.raw:
            self.assignments = all_assignments(log, self._options.assignments)
            yield from self._decoded_again(log, log.evidence(), Part.of_log(log))
        elif log.is_evidence_only or self._logs.are_undecoded:
            self.assignments = all_assignments(log, self._options.assignments)
            yield from self._decoded_again(log, evidence_and_events(log), Part.of_log(log))
        elif self._timing(self.assignments).is_given:
            raise UsageError(
                f"{capture.name}: a log holds what was decoded when it was made; "
                "--t1-5, --t3-5 and --response-timeout need --raw, which decodes it again"
            )
        else:
            part = Part.of_log(log)
            if not part.follows(self._part):
                yield from self._end_capture()
            self._part = part
            self._enter(is_log=True)
            # The transactions of the log already have names and times. So errors in its profiles or
            # links do no harm and are ignored.
            with suppress(UsageError):
                self.assignments = all_assignments(log, self._options.assignments)
            lines: dict[str, SerialLink] = {}
            with suppress(UsageError):
                lines = serial_lines(log)
            self.line_of = lines.get
            timing = LineTiming(self.assignments)
            self.format_of = lambda link: timing.format_of(lines[link]) if link in lines else None
            yield from log_records(
                self._missing.noted(log.items()), self._options.assignments, capture.name
            )
        self._logs.note(log, capture.name)

    def _decoded_again(
        self, log: LinkMetadata, evidence: Iterator[Evidence], part: Part
    ) -> Iterator[Record]:
        """Decode the packets and bytes of a log, or of a capture made from one, again."""
        options = self._options
        ports = options.ports or ports_of(log, PORTS) or (MODBUS_PORT,)
        rtu_ports = options.rtu_ports or ports_of(log, RTU_PORTS)
        self._ports = (ports, rtu_ports)
        # If the user gave TCP ports, those stored in the log are not used.
        self._any_port = options.any_port or (not options.ports and names_any_port(log))
        lines = serial_lines(log)

        def begin() -> Decoder:
            from mbtool.decode.decoder import Decoder

            return Decoder(
                Namer(self.assignments),
                lines=lines,
                timing=self._timing(self.assignments),
                ports=ports,
                rtu_ports=rtu_ports,
                any_port=self._any_port,
                across=ACROSS in log.capture,
            )

        yield from self._decode_file(evidence, part, begin)
