"""Captures from links, decodes bytes and packets, and logs them with the decoded records."""

# One loop in the main thread decodes the bytes and packets of all sources (ports, interfaces,
# taps). With a log, a thread of its own (shared/recorder.py) first writes each item to the log and
# then passes it to this loop. So everything heard is logged, however late the decoder and the
# caller are.
#
# Order at the start: open all sources, begin the log, let taps accept connections. So a link that
# cannot be opened leaves no log behind, and connections cannot use up the file descriptors that the
# log needs. Order at the end: close the sources, log and decode what they had received, complete
# the log. A caller who is in a hurry waits at most HURRY_NS for this decoding; when the log is
# read, it is decoded again as a whole.

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from typing import TYPE_CHECKING, Any, Self, TypeGuard

from mbtool.core import (
    AutoLink,
    Chunk,
    EventKind,
    LinkError,
    LinkSpec,
    Packet,
    SerialLink,
    TapLink,
    UsageError,
    WireEvent,
)
from mbtool.core.moments import counted
from mbtool.modbus import Outcome
from mbtool.ports.clock import ClockWatch, begun_run, monotonic_ns, now_ns
from mbtool.ports.host_names import HostLookup
from mbtool.ports.tcp_listener import THIS_MACHINE, AllowedPeers
from mbtool.sources.inbox import Ended, Inbox, Item
from mbtool.sources.line_guess import guess_line
from mbtool.sources.live import live_source
from mbtool.workflows.shared.capture_parts import MissingParts
from mbtool.workflows.shared.recorder import Log, Recorder

if TYPE_CHECKING:
    from mbtool.decode.decoder import Decoder, Evidence, Record
    from mbtool.sources.source import LiveSource

HURRY_NS = 500_000_000
"""If the caller is in a hurry, decoding goes on for at most this time (ns) after recording has
ended."""
LOOK_NS = 100_000_000
"""The time (ns) between two looks at the system's clock, the recorder and the names of hosts."""
POLL_S = 0.1
"""The loop waits at most this long (seconds) for an item before it calls `stop` again."""
MAX_REASONS = 64
"""At most this many reasons for refusals are reported to the user for one link. There must be a
limit, as a reason may contain a text that the master sent."""


class Sniffer:
    """Captures bytes and packets from links, decodes them, and writes them to a log if wanted.

    It is a context manager: entering it opens the links, leaving it completes the log.
    """

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
        """Prepare to capture from `links`.

        `begin_log` creates the log writer; None for no log. `ports` are the TCP ports to capture
        from interfaces, empty for all. Taps accept only masters in `allowed`. With `reconnects`, a
        serial port or interface that was lost (unplugged) is opened again when it is back;
        otherwise its link ends.

        `on_remark` gets a line for the user in these cases: a link is lost while others remain
        open, or comes back; a source has lost bytes or packets, so that the log lacks them; the
        target of a tap has no address; a tap refuses a master (reported once for each reason, until
        a master is served again). At the
        end: packets were cut, requests were dropped by a limit, or items were not decoded.
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
        """The bytes, packets and events that the sources have heard; the recorder takes them, or
        without a log the decoder."""
        self._undecoded = self._inbox
        """The items that wait to be decoded. With a log, this is another inbox, whose packets and
        bytes are already in the log."""
        self._open_sources = ExitStack()
        self.sources: list[LiveSource[Any]] = []
        """One source for each link, in the same order; empty until the context is entered."""
        self._lookup = HostLookup(())
        self._clocks = ClockWatch()
        self._looked_ns = 0
        self._open = 0
        self._is_complete = False
        """True once recording has ended and no item waits any more: all were decoded, or left
        undecoded for lack of time."""

    @property
    def places(self) -> list[str]:
        """A text for each link that says where it listens. For a tap with port 0 it has the port
        that the system chose.
        """
        return [source.place for source in self.sources]

    @property
    def lost_links(self) -> list[str]:
        """The names of the links that are lost at present, and are opened again when they
        are back.
        """
        return [source.link for source in self.sources if source.is_lost]

    def __enter__(self) -> Self:
        """Open the links and begin the log. Raises LinkError if a link cannot be opened, and the
        errors of `begin_log`.
        """
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
        self._lookup = HostLookup(
            sorted({one.target.host for one in self._links if isinstance(one, TapLink)})
        )
        self._open = len(self._links)
        return self

    def __exit__(self, *error: object) -> None:
        is_interrupted = error[:1] == (KeyboardInterrupt,)
        try:
            for _record in self._received_before_end(lambda: is_interrupted):
                pass  # The caller does not want the record, which has been logged already.
        finally:
            if self._recorder is not None:
                self._recorder.close()

    def records(
        self, stop: Callable[[int], bool], is_hurried: Callable[[], bool] = lambda: False
    ) -> Iterator[Record]:
        """Yield transactions and events as they are decoded, until `stop` returns True or all links
        are lost.

        `stop` is called with the time (UTC ns) at least ten times a second. At the end, everything
        that was heard is decoded; if `is_hurried` returns True, for at most HURRY_NS. Raises
        LinkError when the last link is lost, OutputError when the log cannot be written.
        """
        lost: LinkError | None = None
        while self._open and not stop(at_ns := now_ns()):
            item = self._undecoded.get(POLL_S)
            if at_ns - self._looked_ns >= LOOK_NS:
                self._looked_ns = at_ns
                self._look(at_ns)
            if isinstance(item, Ended):
                self._open -= 1
                lost = item.error or lost
                if item.error is not None and self._open:
                    self._on_remark(str(item.error))
            elif item is not None:
                yield from self._take(item)
        yield from self._received_before_end(is_hurried)
        for remark in self._missing.remarks:
            self._on_remark(remark)
        if lost is not None and not self._open:
            raise lost

    def _look(self, at_ns: int) -> None:
        """Raise the error that has ended the recording, if there is one. Tell the user which hosts
        have no address. Put an event into the inbox if somebody has set the system's clock since
        the last call. `at_ns` is the present time (UTC ns).
        """
        if self._recorder is not None:
            self._recorder.check()
        for problem in self._lookup.problems():
            self._on_remark(f"{problem}; masters are refused until there is one")
        step_ns = self._clocks.take_step()
        if step_ns:
            way = "forward" if step_ns > 0 else "back"
            message = f"the system's clock was set {way} by {abs(step_ns) / 1e9:.3f} s"
            self._inbox.put(
                WireEvent(ts_ns=at_ns, link="", kind=EventKind.CLOCK_STEP, message=message)
            )

    def _take(self, item: Evidence) -> list[Record]:
        """Decode an item; return its transactions and events, after passing them to the log."""
        self._missing.note_item(item)
        if isinstance(item, WireEvent):
            self._report_event(item)
        records = self._log_records(self._decoder.feed(item))
        if self._recorder is not None:
            self._recorder.note_decoded(item)
        return records

    def _report_event(self, event: WireEvent) -> None:
        """Tell the user about an event if it says that a source has lost bytes or packets, or that
        its link was lost or is back.
        """
        is_loss = event.kind is EventKind.DISCARDED and (event.packets or event.missing)
        if is_loss:
            self._on_remark(f"{event.link}: {event.message}")
        elif event.kind is EventKind.GAP:
            self._on_remark(event.message)

    def _received_before_end(self, is_hurried: Callable[[], bool]) -> Iterator[Record]:
        """Close the sources, decode all that they had received, and yield the transactions and
        events.

        If `is_hurried` returns True, decoding ends after HURRY_NS. A second call yields nothing.
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
            yield from self._log_records(self._decoder.close())
            self._report_undecoded(self._recorder.dropped if self._recorder is not None else 0)

    def _leave(self, items: Sequence[Item]) -> None:
        """Leave `items` undecoded, for lack of time; the log already has their bytes and packets.

        Events among the items are written to the log, and the user is told about losses.
        """
        self._is_complete = True
        left = 0
        for item in items:
            left += isinstance(item, Chunk | Packet)
            if isinstance(item, WireEvent):
                self._report_event(item)
                if self._recorder is not None:
                    self._recorder.write(item)
        if self._recorder is not None:
            left += self._recorder.dropped
        self._report_undecoded(left)

    def _report_undecoded(self, count: int) -> None:
        if count:
            then = "; reading the log decodes all of it" if self._recorder is not None else ""
            self._on_remark(
                f"{counted(count, 'piece')} of what was heard not decoded, for lack of time{then}"
            )

    def _log_records(self, records: list[Record]) -> list[Record]:
        for record in records:
            self._missing.note_record(record)
            if self._recorder is not None:
                self._recorder.write(record)
            if self._refusals.note_refusal(record):
                self._on_remark(f"a master was turned away: {record.message}")
        return records


def serial_lines(links: Sequence[LinkSpec]) -> dict[str, SerialLink]:
    """Return the serial links by name. Raises UsageError if two of the links have the same name."""
    names = [link.name for link in links]
    for name in names:
        if names.count(name) > 1:
            raise UsageError(f"two links are called {name!r}; listen to each in a run of its own")
    return {link.name: link for link in links if isinstance(link, SerialLink)}


def with_settings(
    links: Sequence[LinkSpec],
    on_remark: Callable[[str], None],
    on_progress: Callable[[str], None] = lambda _: None,
    wait_s: float | None = None,
) -> list[LinkSpec]:
    """Return the links; for a link with @auto, find its serial settings by listening.

    This takes up to minutes for each such link, at most `wait_s` seconds if it is given.
    `on_remark` gets a line for the user before and after each search, `on_progress` one each few
    seconds. Raises LinkError if no bytes come, or if no settings can be found from them.
    """

    def found(link: AutoLink) -> LinkSpec:
        on_remark(f"finding the settings of {link.name} by listening")
        settled, sentence = guess_line(link, wait_s=wait_s, on_progress=on_progress)
        on_remark(sentence)
        return settled

    return [found(link) if isinstance(link, AutoLink) else link for link in links]


class Refusals:
    """Decides which refusals of a tap are reported: each reason once, until a master is served.

    A refused master usually tries again and again. A master counts as served when a connection that
    was opened after the refusal carries a response. Opening a connection is not enough: with TLS
    1.3 a slave may refuse it right after.

    Memory: for each link with a refusal, at most MAX_REASONS reasons, and the addresses of the
    masters that have connected since and are still connected.
    """

    def __init__(self) -> None:
        self._reasons: dict[str, set[str]] = {}
        self._open: dict[str, set[str]] = {}

    def note_refusal(self, record: Record) -> TypeGuard[WireEvent]:
        """Look at the next record; return True if it is a refusal that must be reported: its reason
        is new.
        """
        link = record.link
        if not isinstance(record, WireEvent):
            is_answered = record.outcome in (Outcome.OK, Outcome.EXCEPTION, Outcome.LATE)
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
