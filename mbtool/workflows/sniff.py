"""Captures from links, decodes bytes and packets, and logs them with the decoded records."""

# One loop serves all sources. Each item (bytes, a packet, a silence) is written to the log before
# it is decoded, and each record is written to the log before the caller gets it.
#
# Order at the start: open all sources, begin the log, let taps accept connections. So a link that
# cannot be opened leaves no log behind, and connections cannot use up the file descriptors that the
# log needs. Order at the end: close the sources, decode what they had received, complete the log.

from __future__ import annotations

from contextlib import ExitStack
from typing import TYPE_CHECKING, Any, Protocol, Self, TypeGuard

from mbtool.core import (
    AutoLink,
    Chunk,
    EventKind,
    LinkError,
    Packet,
    SerialLink,
    UsageError,
    WireEvent,
)
from mbtool.modbus import Outcome
from mbtool.ports.allowed_peers import THIS_MACHINE, AllowedPeers
from mbtool.ports.clock import now_ns
from mbtool.sources.inbox import Ended, Inbox
from mbtool.sources.line_guess import guess_line
from mbtool.sources.live import live_source
from mbtool.workflows.shared.missing_parts import MissingParts

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence

    from mbtool.core import LinkSpec
    from mbtool.decode.decoder import Decoder, Evidence, Record
    from mbtool.devices import NamedTransaction
    from mbtool.sources.source import LiveSource

POLL_S = 0.1
"""The longest wait for an item, in seconds, before the loop reads the clock again."""
MAX_REASONS = 64
"""The most reasons for refusals that are told to the user for one link. There must be a limit, as
part of the reason may be text from a master."""


class Log(Protocol):
    """The part of a log writer that a Sniffer uses."""

    def write(self, item: Chunk | Packet | NamedTransaction | WireEvent) -> None: ...

    def tick(self, now_ns: int) -> None:
        """Called regularly with the time in ns: write items that have been waiting in memory."""

    def close(self, final: Mapping[str, str]) -> None:
        """Complete the log; `final` holds values that are only known at the end of a run."""


class Sniffer:
    """Captures from sources until told to stop. A context manager; its exit completes the log."""

    def __init__(
        self,
        links: Sequence[LinkSpec],
        decoder: Decoder,
        *,
        begin_log: Callable[[], Log] | None = None,
        ports: Sequence[int] = (),
        allowed: AllowedPeers = THIS_MACHINE,
        on_remark: Callable[[str], None] = lambda _: None,
    ) -> None:
        """`on_remark` gets a line for the user in these cases.

        A link is lost while others remain open. A source has lost bytes or packets, so that the log
        lacks them. A tap refuses a master (reported once for each reason, until a master is served
        again). At the end: packets were cut, or requests were dropped by a limit.
        """
        self._links = links
        self._decoder = decoder
        self._begin_log = begin_log
        self._log: Log | None = None
        self._ports = ports
        self._allowed = allowed
        self._on_remark = on_remark
        self._refusals = Refusals()
        self._missing = MissingParts()
        self._inbox = Inbox()
        self._open_sources = ExitStack()
        self.sources: list[LiveSource[Any]] = []
        """One source for each link, in the same order; empty until the context is entered."""
        self._open = 0
        self._discarded_packets = 0
        self._discarded_bytes = 0
        """Number of bytes that the sources lost, without packets that the kernel dropped."""

    @property
    def places(self) -> list[str]:
        """The open links as text; a tap with port 0 shows the port that the system chose."""
        return [source.place for source in self.sources]

    def __enter__(self) -> Self:
        """Open the links and begin the log. Raises LinkError, and the errors of `begin_log`."""
        with ExitStack() as opened:
            for link in self._links:
                source = live_source(link, self._inbox, ports=self._ports, allowed=self._allowed)
                self.sources.append(opened.enter_context(source))
            if self._begin_log is not None:
                self._log = self._begin_log()
            for source in self.sources:
                source.accept()
            self._open_sources = opened.pop_all()
        self._open = len(self._links)
        return self

    def __exit__(self, *_: object) -> None:
        try:
            for _record in self._rest():
                pass  # Nobody reads the record, but _rest has written it to the log.
        finally:
            if self._log is not None:
                self._log.close(
                    {
                        "discarded_packets": str(self._discarded_packets),
                        "discarded_bytes": str(self._discarded_bytes),
                    }
                )

    def records(self, stop: Callable[[int], bool]) -> Iterator[Record]:
        """Yield records as they are decoded, until `stop` returns True or all links are lost.

        `stop` is called with the time (ns) at least ten times a second. Raises LinkError when the
        last link is lost, OutputError when the log cannot be written.
        """
        lost: LinkError | None = None
        while self._open and not stop(now_ns()):
            item = self._inbox.get(POLL_S)
            if isinstance(item, Ended):
                self._open -= 1
                lost = item.error or lost
                if item.error is not None and self._open:
                    self._on_remark(str(item.error))
            elif item is not None:
                yield from self._take(item)
            if self._log is not None:
                self._log.tick(now_ns())
        yield from self._rest()
        for remark in self._missing.remarks:
            self._on_remark(remark)
        if lost is not None and not self._open:
            raise lost

    def _take(self, item: Evidence) -> Iterator[Record]:
        if self._log is not None and isinstance(item, Chunk | Packet):
            self._log.write(item)
        self._missing.note_item(item)
        if isinstance(item, WireEvent) and item.kind is EventKind.DISCARDED:
            self._discarded_packets += item.packets
            self._discarded_bytes += item.missing
            if item.packets or item.missing:
                self._on_remark(f"{item.link}: {item.message}")
        yield from self._logged(self._decoder.feed(item))

    def _rest(self) -> Iterator[Record]:
        """Close the sources, and yield the records of all bytes that they had received.

        A second call yields nothing.
        """
        self._open_sources.close()
        while (item := self._inbox.get(0)) is not None:
            if not isinstance(item, Ended):
                yield from self._take(item)
        yield from self._logged(self._decoder.close())

    def _logged(self, records: list[Record]) -> Iterator[Record]:
        for record in records:
            self._missing.note_record(record)
            if self._log is not None:
                self._log.write(record)
            if self._refusals.is_news(record):
                self._on_remark(f"a master was turned away: {record.message}")
        yield from records


def serial_lines(links: Sequence[LinkSpec]) -> dict[str, SerialLink]:
    """The serial links by the name that chunks have. Raises UsageError if two names are equal."""
    names = [link.name for link in links]
    for name in names:
        if names.count(name) > 1:
            raise UsageError(f"two links are called {name!r}; listen to each in a run of its own")
    return {link.name: link for link in links if isinstance(link, SerialLink)}


def with_settings(links: Sequence[LinkSpec], on_remark: Callable[[str], None]) -> list[LinkSpec]:
    """Return the links; for a serial link without settings, find them by listening.

    This takes up to minutes for each link. `on_remark` gets a line before and after each search.
    Raises LinkError if no bytes come, or none that tell the settings.
    """
    return [_found(link, on_remark) if isinstance(link, AutoLink) else link for link in links]


def _found(link: AutoLink, on_remark: Callable[[str], None]) -> LinkSpec:
    on_remark(f"finding the settings of {link.name} by listening")
    found, sentence = guess_line(link)
    on_remark(sentence)
    return found


class Refusals:
    """Chooses the refusals of a tap to report: each reason once, until a master is served again.

    A refused master usually tries again and again. A master counts as served when a connection
    opened after the refusal carries a response. A response on an older connection does not count,
    nor does opening a connection: with TLS 1.3 a slave may refuse it right after.

    Memory: for each link since its last refusal, at most MAX_REASONS reasons, and the masters'
    endpoints of the connections opened since then.
    """

    def __init__(self) -> None:
        self._reasons: dict[str, set[str]] = {}
        self._open: dict[str, set[str]] = {}

    def is_news(self, record: Record) -> TypeGuard[WireEvent]:
        """Look at the next record. True if it is a refusal for a reason not yet reported."""
        link = record.link
        if not isinstance(record, WireEvent):
            is_answered = record.outcome in (Outcome.OK, Outcome.EXCEPTION)
            if is_answered and record.source in self._open.get(link, ()):
                del self._reasons[link], self._open[link]
            return False
        if record.kind is EventKind.REFUSED:
            reasons = self._reasons.setdefault(link, set())
            if record.message in reasons or len(reasons) >= MAX_REASONS:
                return False
            reasons.add(record.message)
            return True
        if record.kind is EventKind.OPENED and link in self._reasons:
            self._open.setdefault(link, set()).add(record.source)
        elif record.kind is EventKind.CLOSED and link in self._open:
            self._open[link].discard(record.source)
        return False
