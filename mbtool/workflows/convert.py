"""Converts captures and logs into each other: MCAP, pcapng and pcap."""

# Each input capture is read twice (workflows/shared/evidence_reading.py). All captures are merged
# into one in the order of time; items of the same capture keep their order. Packets are written as
# they were captured. In pcapng, frames of serial lines and taps become packets
# (packets/line_packets.py). In a log, the reads of ports stay as they are.
#
# With --start, --end or --where, only the packets and frames of the chosen transactions are
# written, and the damaged frames that were their responses. Without --where, the packets, bytes and
# events in that time that belong to no transaction are written, too.

from __future__ import annotations

import heapq
import os
import platform
import re
import shlex
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from pathlib import Path, PurePath
from typing import TYPE_CHECKING, BinaryIO, NamedTuple, TypeVar

import msgspec

from mbtool.core import (
    Chunk,
    Direction,
    EventKind,
    InputError,
    OutputError,
    Packet,
    SerialFormat,
    UsageError,
    WireEvent,
)
from mbtool.core.errors import reason_of
from mbtool.core.limits import MODBUS_PORT
from mbtool.core.replacing import replacing
from mbtool.devices import NamedTransaction, profile_to_json
from mbtool.logs.creating import check_path, demand_unlocked
from mbtool.logs.links import ACROSS, ANY_PORT, PORTS, RTU_PORTS, SPEC
from mbtool.logs.opening import typed_command
from mbtool.logs.reader import LogReader
from mbtool.logs.writer import LogWriter
from mbtool.packets import CaptureHead
from mbtool.packets.capture_writer import (
    PcapWriter,
)
from mbtool.packets.line_packets import (
    OpenReads,
    error_packet,
)
from mbtool.packets.made_packets import PacketMaker
from mbtool.packets.tcp_ends import tcp_ends
from mbtool.workflows.shared.conversion_inputs import InputGroup, grouped
from mbtool.workflows.shared.evidence_reading import device_of
from mbtool.workflows.shared.pcapng_output import Converted, NumberedPacket, PcapngOutput, Shown
from mbtool.workflows.shared.read_all import CountedWork, Watch, unwatched
from mbtool.workflows.shared.undecoded_logs import evidence_and_events
from mbtool.workflows.shared.wire_streams import SkippedBytes, StreamKey, WirePiece, WireStream

if TYPE_CHECKING:
    from mbtool.decode.decoder import Record
    from mbtool.logs.messages import LogItem
    from mbtool.workflows.shared.reading import ReadingOptions
    from mbtool.workflows.shared.time_window import TimeWindow

T = TypeVar("T")

DEVICE = "{device}"
"""In the name of the file to write, this stands for the name of a slave."""
_UNFIT_FOR_FILE_NAME = re.compile(r"[^\w.-]")
"""The characters of a slave's name that the name of a file must not have; each becomes `_`."""

CAPTURE_SUFFIXES = frozenset((".pcap", ".pcapng", ".mcap"))
_REORDER_NS = 2_000_000_000
"""Frames of a line with two taps are held back for this time (ns) to sort them. The tap of the
slave may record a response before the tap of the master records the request."""


class Conversion:
    """Reads captures and logs, chooses a part of their content, and writes it to one file."""

    def __init__(
        self,
        paths: Sequence[str],
        options: ReadingOptions,
        window: TimeWindow,
        where: Callable[[NamedTransaction], bool] | None = None,
        watch: Watch = unwatched,
        *,
        anonymous: bool = False,
        connections: bool = False,
    ) -> None:
        """Open the files and group them by capture.

        `where` returns True for the transactions to write; None to write all. `watch` passes on the
        items as they are read, and may show the progress. With `anonymous`, the output does not
        name the files, this machine and the command. With `connections`, all packets of the TCP
        connections of the chosen transactions are chosen, too. Raises InputError for a file that
        cannot be read, UsageError for a file of a kind that cannot be converted.
        """
        self._options = options
        self._window = window
        self._where = where
        self._watch = watch
        self._anonymous = anonymous
        self._connections = connections
        self._device: str | None = None
        """The only slave that is written, by the name that `device_of` gives; None for all."""
        self._is_marked = False
        """True once the files were decoded, so that each output needs only their evidence."""
        self._groups = grouped(paths, options)

    @property
    def remarks(self) -> list[str]:
        """Lines for the user about the files; there are none until the files have been read."""
        return [text for group in self._groups for text in group.remarks]

    def demand_whole(self) -> None:
        """Raise the error of the first file that was found cut or damaged; do nothing if there is
        none.
        """
        for group in self._groups:
            if group.broken is not None:
                raise group.broken

    def records(self) -> Iterator[Record]:
        """Yield the chosen transactions and events of all files, in the order of time."""
        for record in self._window.begun(self._all_records(self._watch)):
            if isinstance(record, WireEvent):
                if record in self._window:
                    yield record
            elif self._is_wanted(record):
                yield msgspec.structs.replace(record, file=None) if self._anonymous else record

    def write(
        self, out: str, *, overwrite: bool = False, topic_per_point: bool = False
    ) -> Converted:
        """Write the file `out`. Its suffix gives the format: `.mcap` for a log, `.pcap` or
        `.pcapng`.

        With `overwrite`, an existing file is replaced. With `topic_per_point`, each named value
        (point) gets a topic of its own in a log. Raises UsageError if the file cannot be created,
        or if its format cannot hold the input; OutputError if writing fails.
        """
        check_path(Path(out), replace=overwrite)
        self._read_marks()
        if not os.path.exists(out):
            return self._write_new(out, Path(out), topic_per_point=topic_per_point)
        demand_unlocked(Path(out))
        with replacing(out) as beside:
            done = self._write_to(out, beside, topic_per_point=topic_per_point)
            if not (done.packets or done.reads or done.transactions):
                self.demand_whole()
        return done

    def write_each(self, out: str, *, overwrite: bool = False) -> Iterator[tuple[str, Converted]]:
        """Write a file for each slave; yield its path and what is in it.

        `out` is the path with DEVICE in it, which the name of the slave replaces. All packets of
        the TCP connections of a slave are in its file. Raises the errors of `write`.
        """
        self._read_marks()
        groups = self._groups
        names = sorted({one for group in groups for one in group.marks.devices.values()})
        paths = {name: out.replace(DEVICE, _UNFIT_FOR_FILE_NAME.sub("_", name)) for name in names}
        for path in paths.values():
            check_path(Path(path), replace=overwrite)
        for name, path in paths.items():
            self._device = name
            yield path, self.write(path, overwrite=overwrite)

    def evidence(self) -> Iterator[Shown]:
        """Decode the files, and yield the chosen packets, frames and bytes between frames."""
        self._read_marks()
        return self._items_to_write()

    def events(self) -> Iterator[WireEvent]:
        """Yield the events that tell what ports, taps and interfaces have noticed, in logs and in
        other captures; call `evidence` before.
        """
        for group in self._groups:
            if not group.is_raw:
                yield from filter(self._window.__contains__, group.marks.errors)
                continue
            for path in group.paths:
                with LogReader.open(path) as log, suppress(InputError):
                    for item in evidence_and_events(log):
                        if isinstance(item, WireEvent) and self._window.contains_ns(item.ts_ns):
                            yield item

    def head(self) -> CaptureHead:
        """Return the description of the links and devices; call `evidence` before."""
        return self._head()

    @property
    def modbus_ports(self) -> set[int]:
        """The TCP ports of the slaves whose transactions were found; call `evidence` before."""
        return {port for group in self._groups for port in group.marks.ports}

    @staticmethod
    def reads(shown: Iterable[Shown]) -> Iterator[Packet | Chunk]:
        """Yield packets unchanged, and frames put together again to the reads they came in."""
        return _reads(shown)

    def _write_new(self, out: str, place: Path, *, topic_per_point: bool) -> Converted:
        """Write to the path `place`, at which no file exists yet. Delete the new file if its format
        cannot hold the input. `out` is the path in messages; `topic_per_point` is as for `write`.
        """
        try:
            return self._write_to(out, place, topic_per_point=topic_per_point)
        except UsageError:
            with suppress(OSError):
                place.unlink()
            raise

    def _write_to(self, out: str, place: Path, *, topic_per_point: bool) -> Converted:
        """Write to the path `place`. `out` is the path in messages, and its suffix gives the
        format; `topic_per_point` is as for `write`.
        """
        suffix = PurePath(out).suffix.lower()
        if suffix == ".mcap":
            is_begun = place != Path(out)  # `replacing` has created a temporary file.
            return self._write_log(place, replace=is_begun, topic_per_point=topic_per_point)
        try:
            with place.open("wb") as stream:
                if suffix == ".pcap":
                    return self._write_pcap(stream, out)
                shown = heapq.merge(
                    self._items_to_write(), self._errors(), key=lambda one: one.ts_ns
                )
                return PcapngOutput(stream, self._groups, self._head()).write(shown)
        except OSError as error:
            ends = "; it ends early" if place.exists() else ""
            raise OutputError(f"{out}: cannot be written: {reason_of(error)}{ends}") from error

    def _all_records(self, watch: Watch = unwatched) -> Iterator[Record]:
        """Yield all transactions and events; `watch` sees those of the first group, as the groups
        are read side by side.
        """
        first, *others = self._groups
        return _merge_by_time(
            [first.records(watch), *(group.records() for group in others)], _record_ns
        )

    def _is_wanted(self, one: NamedTransaction) -> bool:
        if self._device is not None and device_of(one) != self._device:
            return False
        return one in self._window and (self._where is None or self._where(one))

    @property
    def _is_whole(self) -> bool:
        return self._where is None and self._window.is_whole

    def _read_marks(self) -> None:
        if self._is_marked:
            return
        self._is_marked = True
        if not self._window.is_whole:
            # Read until the time window knows the first request, from which --start and --end may
            # count.
            next(self._window.begun(self._all_records()), None)
        first = 1
        heard: dict[str, tuple[int, InputGroup]] = {}
        for group in self._groups:
            group.read_marks(self._is_wanted, first, self._watch)
            first += group.marks.transactions
            for link, (begin_ns, end_ns) in group.marks.spans.items():
                if link in heard and heard[link][0] > begin_ns:
                    one, other = heard[link][1].paths[0], group.paths[0]
                    raise UsageError(
                        f"{other}: has bytes of a line {link!r} at the same time as {one}; "
                        "convert the two one by one"
                    )
                heard[link] = end_ns, group

    def _items_to_write(self) -> Iterator[Shown]:
        """Yield what is written: the chosen packets, frames and bytes between frames of all
        captures, in the order of time.
        """
        return _merge_by_time(
            [self._pieces(group) for group in self._groups], lambda one: one.ts_ns
        )

    def _errors(self) -> list[NumberedPacket]:
        """Return packets that tell errors of serial lines, in the order of time; none if only some
        transactions are written.
        """
        if self._where is not None or self._device is not None:
            return []
        events = sorted(self.events(), key=lambda one: one.ts_ns)
        packets = [(one, error_packet(one)) for one in events]
        return [NumberedPacket(packet, (one.message,)) for one, packet in packets if packet]

    def _pieces(self, group: InputGroup) -> Iterator[Shown]:
        read = CountedWork(group.marks.items, "packets", "writing")
        items = self._watch(read, read.counted(group.evidence()))
        pieces = (one for one in _cut_reads(group, items) if self._keeps(group, one))
        if any(key.connection is None and key.direction is not Direction.UNKNOWN
               for key in group.marks.frames):  # fmt: skip
            return _in_time_order(pieces)
        return (one.item for one in pieces)

    def _keeps(self, group: InputGroup, one: _Cut) -> bool:
        if self._device is not None and not self._is_of_device(group, one):
            return False
        if self._is_whole:
            return True
        if isinstance(one.item, NumberedPacket) and (self._connections or self._device is not None):
            return tcp_ends(one.item.packet) in group.marks.connections
        if isinstance(one.item, WirePiece):
            if one.item.frame is not None:
                return one.item.frame.is_kept
            skipped = one.item.skipped
            if skipped is not None and _is_kept(group, one.item.key.link, skipped):
                return True
        elif one.number in group.marks.used:
            return one.number in group.marks.kept
        return self._where is None and self._window.contains_ns(one.item.ts_ns)

    def _is_of_device(self, group: InputGroup, one: _Cut) -> bool:
        """True if the item belongs to the slave that is written."""
        devices = group.marks.devices
        if isinstance(one.item, NumberedPacket):
            ends = tcp_ends(one.item.packet) or ()
            return any(devices.get(end) == self._device for end in ends)
        key, frame = one.item.key, one.item.frame
        if key.connection is not None:
            return key.connection.slave.host == self._device
        return frame is not None and devices.get((key.link, frame.unit)) == self._device

    def _head(self) -> CaptureHead:
        return _joined_heads(self._groups, self._options)

    def _write_pcap(self, stream: BinaryIO, out: str) -> Converted:
        done = Converted()
        writer: PcapWriter | None = None
        link_type = 0
        maker = PacketMaker()
        for one in self._items_to_write():
            packet = one.packet if isinstance(one, NumberedPacket) else _packet_of(one, maker, out)
            if writer is None:
                link_type = packet.link_type
                writer = PcapWriter(stream, link_type)
            if packet.link_type != link_type:
                raise UsageError(
                    f"{out}: classic pcap holds packets of one link type, and there are "
                    f"{link_type} and {packet.link_type}; "
                    f"name it {PurePath(out).with_suffix('.pcapng')}"
                )
            writer.write(packet)
            done.packets += 1
        if writer is None:
            PcapWriter(stream, 1)
        return done

    def _write_log(self, place: Path, *, replace: bool, topic_per_point: bool) -> Converted:
        done = Converted()
        head = self._head()
        capture = {"clock": "that of the captures that it was made from"}
        if not self._anonymous:
            capture |= {
                "host": platform.node(),
                "system": platform.platform(),
                "command": typed_command(),
                "made_from": shlex.join(path for group in self._groups for path in group.paths),
            }
        with LogWriter(place, capture=capture, replace=replace) as log:
            if topic_per_point:
                log.give_points_topics()
            for name, settings in head.links.items():
                log.add_link(name, {k: v for k, v in settings.items() if k != "name"})
            for who, profile in head.devices.items():
                log.add_device(who, profile)
            for name, data in head.profiles.items():
                log.add_profile(name, data)
            for item in self._log_items():
                log.write(item)
                done.packets += isinstance(item, Packet)
                done.reads += isinstance(item, Chunk)
                if not isinstance(item, Packet | Chunk | WireEvent):
                    done.transactions += 1
                    done.points += len(item.points)
        return done

    def _log_items(self) -> Iterator[LogItem]:
        """Yield the packets and reads, and the transactions and events, in the order for a log: a
        transaction or event comes after the packets or reads from which it was decoded.
        """
        evidence: Iterator[LogItem] = _reads(self._items_to_write())
        records: Iterator[LogItem] = (one for one in self.records() if self._belongs(one))
        keyed = _with_sort_keys(evidence, _known_ns, 0), _with_sort_keys(records, _known_ns, 1)
        return (item for _, _, item in heapq.merge(*keyed, key=lambda one: one[:2]))

    def _belongs(self, record: Record) -> bool:
        """False for an event that is about no chosen transaction, if --where chooses them."""
        if self._where is None or not isinstance(record, WireEvent):
            return True
        return any(_is_kept(group, record.link, record) for group in self._groups)


def _is_kept(group: InputGroup, link: str, about: WireEvent | SkippedBytes) -> bool:
    """True if `about` is a damaged frame that was the response to a chosen request."""
    is_damaged = about.kind is EventKind.BAD_CHECK
    return is_damaged and (link, about.ts_ns) in group.marks.kept_damaged


class _Cut(NamedTuple):
    item: Shown
    number: int
    """The number of the packet in its capture, from 1; 0 if `item` is a frame or other serial
    bytes."""


def _cut_reads(group: InputGroup, items: Iterable[Chunk | Packet | WireEvent]) -> Iterator[_Cut]:
    """Yield the packets of a capture with their comments, and the bytes of its serial reads cut
    into frames. `items` is the evidence of the capture.
    """
    marks = group.marks
    streams: dict[StreamKey, WireStream] = {}
    number = 0
    for item in items:
        if isinstance(item, Packet):
            number += 1
            yield _Cut(NumberedPacket(item, marks.comments.get(number, ())), number)
        elif isinstance(item, Chunk):
            key = StreamKey(item.link, item.direction, item.connection)
            stream = streams.get(key)
            if stream is None:
                found = marks.frames.get(key, ()), marks.skipped.get(key, ())
                stream = streams[key] = WireStream(key, *found)
            yield from (_Cut(piece, 0) for piece in stream.feed(item))
    for stream in streams.values():
        yield from (_Cut(piece, 0) for piece in stream.close())


def _in_time_order(pieces: Iterable[_Cut]) -> Iterator[Shown]:
    """Yield the items sorted by time. An item may come after a later one if it is at most
    _REORDER_NS (ns) earlier.
    """
    held: list[tuple[int, int, Shown]] = []
    for number, one in enumerate(pieces):
        heapq.heappush(held, (one.item.ts_ns, number, one.item))
        while held[0][0] < one.item.ts_ns - _REORDER_NS:
            yield heapq.heappop(held)[2]
    while held:
        yield heapq.heappop(held)[2]


def _reads(shown: Iterable[Shown]) -> Iterator[Packet | Chunk]:
    """Yield the packets unchanged, and put the frames and other bytes together again to the reads
    that they were cut from.
    """
    open_reads = OpenReads()
    for one in shown:
        if isinstance(one, NumberedPacket):
            yield one.packet
        else:
            yield from open_reads.take(one.chunk, one.data, one.reads, is_open=one.is_open)
    yield from open_reads.close()


def _packet_of(piece: WirePiece, maker: PacketMaker, out: str) -> Packet:
    """Return a packet with the bytes of a piece. Raises UsageError if they are of a serial line, or
    if an end of their connection has no address.
    """
    key = piece.key
    why = "a serial line"
    if key.connection is not None:
        try:
            return maker.packet(key.connection, key.direction, piece.data, piece.ts_ns)
        except ValueError as error:
            why = f"what was heard between {key.connection.master} and {key.connection.slave}"
            why = f"{why} ({error})"
    raise UsageError(
        f"{out}: classic pcap cannot hold {why}; name it {PurePath(out).with_suffix('.pcapng')}"
    )


def _merge_by_time(parts: Sequence[Iterator[T]], time_of: Callable[[T], int]) -> Iterator[T]:
    """Merge several iterators by time; items of the same iterator keep their order. `time_of`
    returns the time (ns) of an item.
    """
    if len(parts) == 1:
        return parts[0]
    keyed = [_with_sort_keys(part, time_of, index) for index, part in enumerate(parts)]
    return (item for _, _, item in heapq.merge(*keyed, key=lambda one: one[:2]))


def _with_sort_keys(
    items: Iterable[T], time_of: Callable[[T], int], index: int
) -> Iterator[tuple[int, int, T]]:
    """Yield each item with a sort key: the latest time (ns) of the items so far, and `index`, the
    number of this iterator, which orders equal times.
    """
    latest_ns = 0
    for item in items:
        latest_ns = max(latest_ns, time_of(item))
        yield latest_ns, index, item


def _record_ns(record: Record) -> int:
    return record.ts_ns if isinstance(record, WireEvent) else record.start_ns


def _known_ns(item: LogItem) -> int:
    """The time (UTC ns) at which an item of a log was complete: for a transaction, the time of its
    response, or of its request without one.
    """
    if isinstance(item, WireEvent | Packet | Chunk):
        return item.ts_ns
    return item.start_ns if item.response_ns is None else item.response_ns


def _joined_heads(groups: Sequence[InputGroup], options: ReadingOptions) -> CaptureHead:
    """Return one description of the links, devices and profiles of all captures. The ports, devices
    and profiles that the user gave replace those in the captures.
    """
    links: dict[str, dict[str, str]] = {}
    devices = {str(one.who): one.profile.name for one in options.assignments}
    profiles = {one.name: profile_to_json(one) for one in options.assignments.profiles}
    ports = [*map(str, options.ports), *([ANY_PORT] if options.any_port else [])]
    rtu_ports = [*map(str, options.rtu_ports)]
    for group in groups:
        for name, settings in group.head.links.items():
            one = links.setdefault(name, dict(settings))
            if ports and PORTS in one:
                one[PORTS] = " ".join(ports)
        for who, profile in group.head.devices.items():
            devices.setdefault(who, profile)
        for name, data in group.head.profiles.items():
            profiles.setdefault(name, data)
        for link in group.marks.spans:
            links.setdefault(link, {SPEC: _spec(group, link)})
    if ports or rtu_ports:
        named = {PORTS: " ".join(ports or [str(MODBUS_PORT)]), RTU_PORTS: " ".join(rtu_ports)}
        links["packets"] = named
    capture = {} if any(group.is_log for group in groups) else {ACROSS: "1"}
    return CaptureHead(capture={"made_by": "mbtool", **capture}, links=links, devices=devices,
                       profiles=profiles)  # fmt: skip


def _spec(group: InputGroup, link: str) -> str:
    """Make the LINK text, such as `rtu:COM3@9600-8N1`, of a serial line that no log describes.
    Unknown settings become the standard's.
    """
    line = group.line_of(link)
    if line is None:
        return f"rtu:{link}@{SerialFormat()}"
    port = "".join("_" if each in ",@=:" else each for each in link)
    return f"{'ascii' if line.ascii else 'rtu'}:{port}@{line.format}"
