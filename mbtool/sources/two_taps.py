"""Two serial ports as one live source: one receives the master's bytes, the other the slaves'."""

# Each port has a reading process and a thread of its own; each chunk says which side sent it. A
# Quiet item means that all bytes received before its time are in the inbox. Each port knows this
# only for itself, so this source puts a Quiet with the earlier of the two times. When the clock is
# set back, these times go back, too. When one port is gone, the other one is ended, too; its last
# bytes come before the Ended of this source.

from __future__ import annotations

from collections.abc import Mapping
from contextlib import ExitStack
from threading import Lock

from mbtool.core import Chunk, Direction, LinkError, Quiet, SerialLink
from mbtool.core.limits import MAX_CLOCK_STEP_NS
from mbtool.sources.inbox import Ended, Item, Sink
from mbtool.sources.serial_capture import SerialSource
from mbtool.sources.source import LiveSource


class TwoTapsSource(LiveSource[SerialLink]):
    """Captures both ports of a link while its context is open.

    Entering the context raises LinkError if a port cannot be opened.
    """

    def __init__(
        self, link: SerialLink, inbox: Sink, *, places: Mapping[str, str] | None = None
    ) -> None:
        """Create a source for a link of two ports.

        `places` gives the present path of a port whose path has changed since the link was named.
        """
        super().__init__(link, inbox)
        self._lock = Lock()
        self._taps = {
            speaker: SerialSource(link, _Tap(self, speaker), speaker, places=places)
            for speaker in (Direction.REQUEST, Direction.RESPONSE)
        }
        self._known_ns = dict.fromkeys(self._taps, 0)
        """For the port that hears the master (REQUEST) and the one that hears the slaves
        (RESPONSE): the time in UTC ns up to which all its bytes are in the inbox."""
        self._quiet_ns = 0
        """The time in UTC ns of the last Quiet item, 0 before the first: all bytes of both ports up
        to this time are in the inbox."""
        self._listening = set(self._taps)
        self._error: LinkError | None = None
        self._opened = ExitStack()

    @property
    def taps(self) -> list[SerialSource]:
        """The source at the master's side and the source at the slaves' side."""
        return list(self._taps.values())

    def open(self) -> None:
        with ExitStack() as opened:
            for tap in self._taps.values():
                opened.enter_context(tap)
            self._opened = opened.pop_all()
        with self._lock:
            if self._error is not None:  # The first port was lost before the second was open.
                self._tell_to_end()

    def close(self) -> None:
        with self._lock:
            self._tell_to_end()
        self._opened.close()

    def put(self, item: Item, speaker: Direction) -> None:
        """Take an item from one of the two ports; any thread may call this.

        `speaker` says whose bytes this port receives: REQUEST the master's, RESPONSE the slaves'.
        """
        with self._lock:
            if isinstance(item, Ended):
                self._end(item, speaker)
                return
            if not isinstance(item, Quiet):
                self._inbox.put(item)
            if isinstance(item, Quiet | Chunk):
                self._known_ns[speaker] = _known_until(self._known_ns[speaker], item.ts_ns)
                self._put_quiet()

    def _put_quiet(self) -> None:
        quiet_ns = _known_until(self._quiet_ns, min(self._known_ns.values()))
        if quiet_ns != self._quiet_ns:
            self._quiet_ns = quiet_ns
            self._inbox.put(Quiet(quiet_ns, self.link))

    def _end(self, ended: Ended, speaker: Direction) -> None:
        self._listening.discard(speaker)
        if ended.error is not None and self._error is None:
            self._error = LinkError(f"link {self._link} needs both its ports: {ended.error}")
            self._tell_to_end()
        if not self._listening:
            self._inbox.put(Ended(self.link, self._error))

    def _tell_to_end(self) -> None:
        for tap in self._taps.values():
            tap.tell_to_end()


def _known_until(until_ns: int, ts_ns: int) -> int:
    """Return the time (UTC ns) up to which all bytes of a port are known.

    `until_ns` is that time so far and `ts_ns` a new one; the later one is returned. If `ts_ns` is
    more than MAX_CLOCK_STEP_NS earlier, the clock was set back, and `ts_ns` is returned.
    """
    return ts_ns if ts_ns < until_ns - MAX_CLOCK_STEP_NS else max(until_ns, ts_ns)


class _Tap:
    """The sink for the items of one of the two ports.

    It passes them on to `source`, together with `speaker`, the direction of the bytes that the port
    receives.
    """

    def __init__(self, source: TwoTapsSource, speaker: Direction) -> None:
        self._source = source
        self._speaker = speaker

    def put(self, item: Item) -> None:
        self._source.put(item, self._speaker)
