"""Captures from links, decodes bytes and packets, and logs them with the decoded records."""

# One loop serves all sources. With a log, a thread of its own (shared/recorder.py) writes each item
# (bytes, a packet) to the log and only then gives it to the loop, which decodes it. So evidence is
# logged however late the decoder and the caller are.
#
# Order at the start: open all sources, begin the log, let taps accept connections. So a link that
# cannot be opened leaves no log behind, and connections cannot use up the file descriptors that the
# log needs. Order at the end: close the sources, log and decode what they had received, complete
# the log. A caller who is in a hurry waits at most HURRY_NS for the decoding; reading the log
# decodes the rest.

from __future__ import annotations

from contextlib import ExitStack
from typing import TYPE_CHECKING, Any, Self, TypeGuard

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
from mbtool.core.wording import counted
from mbtool.modbus import Outcome
from mbtool.ports.allowed_peers import THIS_MACHINE, AllowedPeers
from mbtool.ports.clock import ClockWatch, begun_run, monotonic_ns, now_ns
from mbtool.sources.inbox import Ended, Inbox
from mbtool.sources.line_guess import guess_line
from mbtool.sources.live import live_source
from mbtool.workflows.shared.missing_parts import MissingParts
from mbtool.workflows.shared.recorder import Recorder

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from mbtool.core import LinkSpec
    from mbtool.decode.decoder import Decoder, Evidence, Record
    from mbtool.sources.inbox import Item
    from mbtool.sources.source import LiveSource
    from mbtool.workflows.shared.recorder import Log

HURRY_NS = 500_000_000
"""The longest time in ns that a caller in a hurry waits for the decoding at the end."""
CLOCK_LOOK_NS = 100_000_000
"""Time in ns between two looks at the system's clock."""
POLL_S = 0.1
"""The longest wait for an item, in seconds, before the loop reads the clock again."""
MAX_REASONS = 64
"""The most reasons for refusals that are told to the user for one link. There must be a limit, as
part of the reason may be text from a master."""


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
        reconnects: bool = False,
        on_remark: Callable[[str], None] = lambda _: None,
    ) -> None:
        """With `reconnects`, a serial port or an interface that is lost is opened again when it is
        back; without, it ends.

        `on_remark` gets a line for the user in these cases. A link is lost while others remain
        open, or comes back. A source has lost bytes or packets, so that the log
        lacks them. A tap refuses a master (reported once for each reason, until a master is served
        again). At the end: packets were cut, requests were dropped by a limit, or a part of what
        was heard is not decoded.
        """
        self._links = links
        self._decoder = decoder
        self._begin_log = begin_log
        self._recorder: Recorder | None = None
        self._ports = ports
        self._allowed = allowed
        self._reconnects = reconnects
        self._on_remark = on_remark
        self._refusals = Refusals()
        self._missing = MissingParts()
        self._inbox = Inbox()
        """What the sources hear."""
        self._undecoded = self._inbox
        """What is to be decoded; with a log, what has been recorded."""
        self._open_sources = ExitStack()
        self.sources: list[LiveSource[Any]] = []
        """One source for each link, in the same order; empty until the context is entered."""
        self._clocks = ClockWatch()
        self._looked_ns = 0
        self._open = 0
        self._is_complete = False
        """True once everything that was heard has been decoded or left."""

    @property
    def places(self) -> list[str]:
        """The open links as text; a tap with port 0 shows the port that the system chose."""
        return [source.place for source in self.sources]

    @property
    def lost_links(self) -> list[str]:
        """The names of the links that are lost at present, and looked for."""
        return [source.link for source in self.sources if source.is_lost]

    def __enter__(self) -> Self:
        """Open the links and begin the log. Raises LinkError, and the errors of `begin_log`."""
        with ExitStack() as opened:
            opened.enter_context(begun_run())
            self._clocks = ClockWatch()
            for link in self._links:
                source = live_source(
                    link,
                    self._inbox,
                    ports=self._ports,
                    allowed=self._allowed,
                    returns=self._reconnects,
                )
                self.sources.append(opened.enter_context(source))
            if self._begin_log is not None:
                self._recorder = Recorder(self._inbox, self._begin_log(), now_ns)
                self._undecoded = self._recorder.undecoded
                self._recorder.start()
            for source in self.sources:
                source.accept()
            self._open_sources = opened.pop_all()
        self._open = len(self._links)
        return self

    def __exit__(self, *error: object) -> None:
        is_interrupted = error[:1] == (KeyboardInterrupt,)
        try:
            for _record in self._rest(lambda: is_interrupted):
                pass  # Nobody reads the record, but _rest has written it to the log.
        finally:
            if self._recorder is not None:
                self._recorder.close()

    def records(
        self, stop: Callable[[int], bool], is_hurried: Callable[[], bool] = lambda: False
    ) -> Iterator[Record]:
        """Yield records as they are decoded, until `stop` returns True or all links are lost.

        `stop` is called with the time (ns) at least ten times a second. At the end everything that
        was heard is decoded; once `is_hurried` returns True, for at most HURRY_NS. Raises LinkError
        when the last link is lost, OutputError when the log cannot be written.
        """
        lost: LinkError | None = None
        while self._open and not stop(now_ns()):
            item = self._undecoded.get(POLL_S)
            self._tell_clock_step()
            if self._recorder is not None:
                self._recorder.check()
            if isinstance(item, Ended):
                self._open -= 1
                lost = item.error or lost
                if item.error is not None and self._open:
                    self._on_remark(str(item.error))
            elif item is not None:
                yield from self._take(item)
        yield from self._rest(is_hurried)
        for remark in self._missing.remarks:
            self._on_remark(remark)
        if lost is not None and not self._open:
            raise lost

    def _tell_clock_step(self) -> None:
        """Put an event into the inbox if somebody has set the system's clock."""
        at_ns = now_ns()
        if at_ns - self._looked_ns < CLOCK_LOOK_NS:
            return
        self._looked_ns = at_ns
        step_ns = self._clocks.take_step()
        if step_ns:
            way = "forward" if step_ns > 0 else "back"
            message = f"the system's clock was set {way} by {abs(step_ns) / 1e9:.3f} s"
            self._inbox.put(
                WireEvent(ts_ns=at_ns, link="", kind=EventKind.CLOCK_STEP, message=message)
            )

    def _take(self, item: Evidence) -> list[Record]:
        """Decode an item; return its records, which the log has or gets."""
        self._missing.note_item(item)
        if isinstance(item, WireEvent):
            self._tell_event(item)
        records = self._logged(self._decoder.feed(item))
        if self._recorder is not None:
            self._recorder.note_decoded(item)
        return records

    def _tell_event(self, event: WireEvent) -> None:
        """Tell the user that a source has lost bytes or packets, or its link, or found it again."""
        is_loss = event.kind is EventKind.DISCARDED and (event.packets or event.missing)
        if is_loss:
            self._on_remark(f"{event.link}: {event.message}")
        elif event.kind is EventKind.GAP:
            self._on_remark(event.message)

    def _rest(self, is_hurried: Callable[[], bool]) -> Iterator[Record]:
        """Close the sources, and yield the records of all bytes that they had received.

        A second call yields nothing.
        """
        self._open_sources.close()
        if self._recorder is not None:
            self._recorder.stop()
        end_ns = monotonic_ns() + HURRY_NS
        while (item := self._undecoded.get(0)) is not None:
            if is_hurried() and monotonic_ns() > end_ns:
                self._leave([item, *self._undecoded.take(0, len(self._undecoded))])
                return
            if not isinstance(item, Ended):
                yield from self._take(item)
        if not self._is_complete:
            self._is_complete = True
            yield from self._logged(self._decoder.close())
            self._tell_undecoded(self._recorder.dropped if self._recorder is not None else 0)

    def _leave(self, items: Sequence[Item]) -> None:
        """Leave items undecoded. The log has the bytes and packets, and gets the events.

        The user is told of losses among them.
        """
        self._is_complete = True
        left = 0
        for item in items:
            left += isinstance(item, Chunk | Packet)
            if isinstance(item, WireEvent):
                self._tell_event(item)
                if self._recorder is not None:
                    self._recorder.write(item)
        if self._recorder is not None:
            left += self._recorder.dropped
        self._tell_undecoded(left)

    def _tell_undecoded(self, count: int) -> None:
        if count:
            then = "; reading the log decodes all of it" if self._recorder is not None else ""
            self._on_remark(
                f"{counted(count, 'piece')} of what was heard not decoded, for lack of time{then}"
            )

    def _logged(self, records: list[Record]) -> list[Record]:
        for record in records:
            self._missing.note_record(record)
            if self._recorder is not None:
                self._recorder.write(record)
            if self._refusals.is_news(record):
                self._on_remark(f"a master was turned away: {record.message}")
        return records


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
