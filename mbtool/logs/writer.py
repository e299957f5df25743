"""Writes a log: captured bytes, what was decoded from them, and the metadata for reading both."""

# Reads of serial lines are joined, because a message for each byte takes 40 times its space:
# all reads of one line since the last flush become one message (evidence_blocks.py). Other items
# that are written meanwhile are held back and follow the joined reads in the file: first other
# captured data, then everything else. Apart from that, the file has the order of the calls. So if
# captured bytes are written before they are decoded, they come before the transactions decoded from
# them.
#
# The writer has no clock: `tick` gives it the time. It flushes once something may have been in
# memory for FLUSH_AFTER_NS, so with ten ticks a second at most 0.6 s of a capture are in memory. If
# LARGE bytes or more are in memory, it flushes after FLUSH_LARGE_AFTER_NS: large chunks are
# compressed well anyway. Flushed data are synced to the disk at most once in FLUSH_AFTER_NS, by a
# thread (DiskSync in complete_file.py). A log that is converted from a file needs no ticks.
#
# Memory: MAX_READS serial reads, MAX_WAITING messages kept back behind them, one chunk, the last
# value of each point (points.py), and the file's indexes (container.py). Links after the first
# MAX_LINKS share the topics of OTHER_LINKS; each of their messages still names its own link.

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO

import msgspec
from mcap.records import Header

from mbtool.core import Chunk, EventKind, OutputError, Packet
from mbtool.core.closing import ClosesOnExit
from mbtool.core.errors import reason_of
from mbtool.devices import NamedTransaction, finding_text
from mbtool.devices.checking.rules import Severity, severity_of
from mbtool.logs import schemas
from mbtool.logs.complete_file import CompleteFile
from mbtool.logs.container import Container, Topic
from mbtool.logs.creating import create_file
from mbtool.logs.evidence_blocks import MAX_READS, is_joinable, pack_reads
from mbtool.logs.layout import (
    CAPTURE,
    DECODING_TOPIC,
    DEVICE,
    FORMAT_VERSION,
    LIBRARY,
    LINK,
    MAGIC,
    PROFILE,
    PROFILE_MEDIA_TYPE,
    STATUS,
    pack_records,
)
from mbtool.logs.messages import (
    ChunkMessage,
    DecodingMark,
    EventMessage,
    Level,
    LogItem,
    LogMessage,
    LogTime,
    PointMessage,
)
from mbtool.logs.points import PointChanges, PointTopics
from mbtool.version import __version__

if TYPE_CHECKING:
    from mbtool.devices.checking.finding import Finding

FLUSH_AFTER_NS = 500_000_000
FLUSH_LARGE_AFTER_NS = 150_000_000
LARGE = 32 * 1024
MAX_WAITING = 2000
"""The most messages other than serial reads that are kept in memory until the serial reads before
them are joined into one message and written."""
MAX_READ_BYTES = 64 * 1024
"""The most bytes of serial reads that are kept in memory until they are joined into one message and
written."""
MAX_LINKS = 10_000
OTHER_LINKS = "others"


_Waiting = tuple[Topic, int, int, bytes]
"""A message that is kept back: its topic, log time and publish time (both in ns), and its data."""


class LogWriter(ClosesOnExit):
    """A log that is complete on disk at every moment; a context manager whose exit closes it."""

    def __init__(
        self,
        path: str | Path,
        *,
        capture: Mapping[str, str],
        replace: bool = False,
        make_room: Callable[[], bool] = lambda: False,
    ) -> None:
        """Create the file. `capture` is metadata of the run: host, command, clock.

        `make_room` is called when the disk is full; it returns True if it has removed another file.

        Raises UsageError if the file cannot be created, or if it exists and `replace` is False.
        Raises OutputError if another recorder has the file open. The same error is raised if the
        disk has no room for the beginning of the log; a file that was created for it is removed.
        """
        self._path = Path(path)
        is_new = not self._path.exists()
        file = create_file(self._path, replace=replace)
        try:
            self._begin(file, capture, make_room)
        except OutputError as error:
            file.close()
            if is_new:
                with suppress(OSError):
                    self._path.unlink()
            reason = reason_of(error.__cause__) if isinstance(error.__cause__, OSError) else error
            raise OutputError(f"{path}: the log cannot be begun: {reason}") from error

    def _begin(
        self, file: BinaryIO, capture: Mapping[str, str], make_room: Callable[[], bool]
    ) -> None:
        header = Header(profile=PROFILE, library=f"{LIBRARY}{__version__}")
        self._file = CompleteFile(file, str(self._path), MAGIC + pack_records(header), make_room)
        self._container = Container(self._file)
        self._reads: dict[str, list[Chunk]] = {}
        """The reads of serial lines since the last flush, by link name. They are not yet joined
        into messages."""
        self._read_count = self._read_bytes = 0
        self._evidence: list[_Waiting] = []
        """Captured chunks and packets that are not serial reads. They are written after the reads
        in `_reads`."""
        self._decoded: list[_Waiting] = []
        """Decoded messages. They are written after all captured data that are kept in memory."""
        self._topics: dict[tuple[str, str], Topic] = {}
        self._links: set[str] = set()
        self._encode = msgspec.json.Encoder().encode
        self._points = PointChanges()
        self._point_topics: PointTopics | None = None
        self._flushed_ns = 0
        self._synced = 0
        """The file offset behind the last record at the last request for a sync to the disk."""
        self._synced_ns = 0
        self._capture = {
            "log_format": str(FORMAT_VERSION),
            "version": __version__,
            **_clean(capture),
        }
        self._container.add_metadata(CAPTURE, self._capture)
        self._container.flush(sync=True)

    @property
    def path(self) -> Path:
        return self._path

    @property
    def size(self) -> int:
        """The size of the file so far, in bytes."""
        return self._file.size

    def hold(self) -> BinaryIO:
        """Return a second handle of the open file, which the caller closes.

        The file stays locked until both handles are closed.
        """
        return self._file.hold()

    def write(self, item: LogItem | DecodingMark) -> None:
        """Add one item. Raises OutputError if it cannot be written."""
        if isinstance(item, NamedTransaction):
            self._write_transaction(item)
        elif isinstance(item, Chunk) and is_joinable(item):
            self._add_read(item)
        elif isinstance(item, Chunk | Packet):
            if item.link in self._reads:
                self._join_reads()
            topic = self._topic(item.link, "chunks", schemas.CHUNK)
            self._add(topic, item.ts_ns, item.ts_ns, ChunkMessage.of(item), is_evidence=True)
        elif isinstance(item, DecodingMark):
            topic = self._topic("", DECODING_TOPIC, schemas.DECODING)
            self._add(topic, item.ts_ns, item.ts_ns, item)
        else:
            if item.kind is EventKind.GAP:
                self._join_reads()  # Reads before and after the gap must not be in one message.
            topic = self._topic(item.link, "events", schemas.WIRE_EVENT)
            self._add(topic, item.ts_ns, item.ts_ns, EventMessage.of(item))

    def add_finding(self, finding: Finding, known_ns: int) -> None:
        """Add a finding (a broken rule) that only several transactions together show.

        `known_ns`, UTC ns, is the time of the last transaction or event that was needed to find it.
        `write` adds a finding about a single transaction together with that transaction.
        """
        sec, nsec = divmod(max(finding.ts_ns, 0), 1_000_000_000)
        place = finding.link if finding.unit is None else f"{finding.link} unit {finding.unit}"
        times = f" ({finding.count} times)" if finding.count > 1 else ""
        message = LogMessage(
            timestamp=LogTime(sec=sec, nsec=nsec),
            level=_LEVELS[finding.severity],
            message=f"{finding.code} {place}: {finding.message}{times}",
            name=finding.code,
            file=finding.link,
            line=finding.unit or 0,
        )
        self._add(self._topic("", "findings", schemas.LOG), known_ns, finding.ts_ns, message)

    def add_link(self, name: str, settings: Mapping[str, str]) -> None:
        """Add a link's settings as metadata: its LINK as text and its TCP ports."""
        self._join_reads()
        self._container.add_metadata(LINK, _clean({"name": name, **settings}))

    def add_device(self, who: str, profile: str) -> None:
        """Record which device has which profile; `who` names the device as `--device` does."""
        self._join_reads()
        self._container.add_metadata(DEVICE, _clean({"who": who, "profile": profile}))

    def give_points_topics(self) -> None:
        """Have each point (a named value of a device) written to a topic of its own, too.

        From now on, a point is written there whenever it has changed.
        """
        self._point_topics = PointTopics()

    def add_status(self, values: Mapping[str, str]) -> None:
        """Add a heartbeat: `values` describe the state of the recording, and become metadata."""
        self._join_reads()
        self._container.add_metadata(STATUS, _clean(values))

    def add_profile(self, name: str, profile_json: bytes) -> None:
        """Attach the complete device profile `name`, as JSON."""
        self._join_reads()
        (clean,) = _clean({name: ""})
        self._container.add_attachment(clean, PROFILE_MEDIA_TYPE, profile_json)

    def tick(self, now_ns: int) -> None:
        """Flush to the file if that is due. `now_ns` is the time in ns of a clock that never steps.

        Raises OutputError if the file cannot be written.
        """
        pending = self._container.pending + self._read_bytes + self._read_count
        after_ns = FLUSH_AFTER_NS if pending < LARGE else FLUSH_LARGE_AFTER_NS
        if not pending:
            self._flushed_ns = now_ns
        elif not 0 <= now_ns - self._flushed_ns < after_ns:
            self._join_reads()
            self._container.flush(sync=False)
            self._flushed_ns = now_ns
        if self._file.position == self._synced:
            self._synced_ns = min(self._synced_ns, now_ns)
        elif not 0 <= now_ns - self._synced_ns < FLUSH_AFTER_NS:
            self._file.sync_soon()
            self._synced, self._synced_ns = self._file.position, now_ns

    def close(self, final: Mapping[str, str] | None = None) -> None:
        """Write what is in memory and the summary, and close the file.

        `final` is metadata that is known only at the end: the numbers of dropped bytes and packets.
        A second call does nothing. Raises OutputError if the file cannot be written; it is closed
        all the same.
        """
        if self._file.closed:
            return
        try:
            self._join_reads()
            if final:
                self._container.add_metadata(CAPTURE, {**self._capture, **_clean(final)})
            self._container.finish()
        finally:
            self._file.close()

    def _add_read(self, read: Chunk) -> None:
        self._reads.setdefault(read.link, []).append(read)
        self._read_count += 1
        self._read_bytes += len(read.data)
        if self._read_count >= MAX_READS or self._read_bytes >= MAX_READ_BYTES:
            self._join_reads()

    def _join_reads(self) -> None:
        """Write the serial reads since the last call, then the messages kept back behind them.

        The reads of each serial line become one message.
        """
        found, self._reads = self._reads, {}
        waiting, self._evidence, self._decoded = self._evidence + self._decoded, [], []
        self._read_count = self._read_bytes = 0
        for link, reads in found.items():
            topic = self._topic(link, "evidence", schemas.EVIDENCE)
            begin_ns = reads[0].ts_ns
            self._container.add_message(topic, begin_ns, begin_ns, pack_reads(reads))
        for one in waiting:
            self._container.add_message(*one)

    def _write_transaction(self, item: NamedTransaction) -> None:
        # The log time is that of the transaction's last byte, so that no viewer shows the
        # transaction before the bytes it was decoded from.
        known_ns = item.start_ns if item.response_ns is None else item.response_ns
        topic = self._topic(item.link, "transactions", schemas.TRANSACTION)
        self._add(topic, known_ns, item.start_ns, item)
        for change in self._points.changes(item, known_ns):
            points = self._topic("", "points", schemas.POINT_VALUE)
            self._add(points, known_ns, item.start_ns, change)
            own = self._own_topic(change)
            if own is not None:
                self._add(own, known_ns, item.start_ns, change)
        for code in item.findings:
            findings = self._topic("", "findings", schemas.LOG)
            self._add(findings, known_ns, item.start_ns, _finding(code, item, known_ns))

    def _own_topic(self, point: PointMessage) -> Topic | None:
        """Return the topic that a point (a named value of a device) has for itself.

        Returns None if such topics are not wanted, or if MAX_POINT_TOPICS points have one already.
        """
        name = None if self._point_topics is None else self._point_topics.name_of(point)
        if name is None:
            return None
        topic = self._topics.get(("", name))
        if topic is None:
            topic = self._container.add_topic(name, schemas.schema_of(schemas.POINT_VALUE))
            self._topics["", name] = topic
        return topic

    def _add(
        self,
        topic: Topic,
        log_ns: int,
        publish_ns: int,
        message: msgspec.Struct,
        *,
        is_evidence: bool = False,
    ) -> None:
        data = self._encode(message)
        if not self._reads:
            self._container.add_message(topic, log_ns, publish_ns, data)
            return
        waiting = self._evidence if is_evidence else self._decoded
        waiting.append((topic, log_ns, publish_ns, data))
        if len(waiting) >= MAX_WAITING:
            self._join_reads()

    def _topic(self, link: str, kind: str, schema: str) -> Topic:
        """Return a link's topic for one kind of messages, such as "events"; create it if needed.

        `link` "" means the topic that all links share; `schema` names the schema of the messages.
        """
        topic = self._topics.get((link, kind))
        if topic is not None:
            return topic
        if link and link not in self._links:
            if len(self._links) >= MAX_LINKS and link != OTHER_LINKS:
                return self._topic(OTHER_LINKS, kind, schema)
            self._links.add(link)
        topic = self._container.add_topic(topic_name(link, kind), schemas.schema_of(schema))
        self._topics[link, kind] = topic
        return topic


def topic_name(link: str, kind: str) -> str:
    """The name of a topic: "/bus/events" for the link "bus" and the kind "events".

    Link "" stands for a topic that all links share: "/events".
    """
    return f"/{link.replace('/', '_')}/{kind}" if link else f"/{kind}"


_LEVELS = {
    Severity.ERROR: Level.ERROR,
    Severity.WARNING: Level.WARNING,
    Severity.NOTE: Level.INFO,
}


def _finding(code: str, item: NamedTransaction, ts_ns: int) -> LogMessage:
    sec, nsec = divmod(max(ts_ns, 0), 1_000_000_000)
    about = f"{item.function_name} {item.reference}" if item.reference else item.function_name
    return LogMessage(
        timestamp=LogTime(sec=sec, nsec=nsec),
        level=_LEVELS[severity_of(code)],
        message=f"{code} {finding_text(code)}: {item.link} unit {item.unit} {about}",
        name=code,
        file=item.link,
        line=item.unit,
    )


def _clean(values: Mapping[str, str]) -> dict[str, str]:
    """Replace characters that UTF-8 cannot encode by "?": a command line may hold any bytes."""
    return {_text(key): _text(value) for key, value in values.items()}


def _text(text: str) -> str:
    return text.encode(errors="replace").decode()
