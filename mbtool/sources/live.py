"""Creates the live source (serial port, interface or tap) that a LINK of the user names."""

# The module of a source is imported only when it is needed, as the imports of scapy and pyserial
# take long.

from __future__ import annotations

from contextlib import ExitStack
from functools import partial
from threading import Event, Lock
from typing import TYPE_CHECKING, Any

from mbtool.core import (
    AutoLink,
    Chunk,
    Direction,
    EventKind,
    InterfaceLink,
    LinkError,
    LinkSpec,
    Quiet,
    SerialLink,
    TapLink,
    TcpLink,
    UsageError,
    WireEvent,
)
from mbtool.core.limits import MAX_CLOCK_STEP_NS, MODBUS_PORT
from mbtool.ports.clock import monotonic_ns, now_ns
from mbtool.ports.local_ports import find_port, identity_of
from mbtool.ports.tcp_listener import THIS_MACHINE, AllowedPeers
from mbtool.sources.inbox import Ended
from mbtool.sources.serial_capture import SerialSource
from mbtool.sources.source import LiveSource

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence
    from contextlib import AbstractContextManager

    from mbtool.ports.local_ports import PortIdentity
    from mbtool.sources.inbox import Inbox, Item, PatientSink, Sink

    MakeSource = Callable[[Any, Mapping[str, str]], LiveSource[Any]]
    """A function that creates a source. Its first argument is the sink for the source's items. The
    second gives the present path of a port for each path in the link; it is empty at first."""

# A live source that opens its port or interface again when it comes back after it was lost.
#
# A source ends with an error when its adapter is unplugged or its interface goes down. Then this
# source puts a GAP event, closes the lost source, and tries to open the link again: after 0.25 s,
# then after twice as long each time, up to 5 s while the link is there but cannot be opened, and up
# to 1 s while it is not there, as looking into /dev costs little. A serial port is found under
# another name, too (ports/local_ports.py). When the link is open again, another GAP event says
# how long it was away. All items keep the name of the link.
#
# If the first opening fails, it is not repeated: a link that is absent at the start is probably a
# mistake of the user.

FIRST_LOOK_S = 0.25
ABSENT_LOOK_S = 1.0
LAST_LOOK_S = 5.0


class ReturningSource(LiveSource[SerialLink | InterfaceLink]):
    """Captures a link while its context is open, also after the link was lost and came back.

    Entering the context raises LinkError if the link cannot be opened.
    """

    def __init__(self, link: SerialLink | InterfaceLink, inbox: Inbox, make: MakeSource) -> None:
        super().__init__(link, inbox)
        self._heard = inbox
        self._make = make
        self._source: LiveSource[Any] = make(self, {})
        self._identities: dict[str, PortIdentity | None] = {}
        self._lock = Lock()
        self._is_closing = False
        self._has_ended = False
        self._wanted = Event()
        """Wakes the thread: it is set when the link was lost, and when this source is to end."""
        self._lost_ns = 0

    @property
    def current(self) -> LiveSource[Any]:
        """The source that captures now; while the link is lost, the one that captured last."""
        return self._source

    def open(self) -> None:
        self._source.open()
        if isinstance(self._link, SerialLink):
            self._identities = {port: identity_of(port) for port in self._link.ports}
        self._start_thread(self._keep)

    def close(self) -> None:
        with self._lock:
            self._is_closing = True
        self._wanted.set()
        if self._thread is not None:
            self._thread.join()
        self._source.close()
        with self._lock:
            has_ended, self._has_ended = self._has_ended, True
        if not has_ended:
            self._inbox.put(Ended(self.link))

    def put(self, item: Item) -> None:
        """Take an item of the present source, and put it into the inbox.

        An Ended item (the source has ended) is not put into the inbox. If this item has an error,
        the link was lost: the thread then tries to open the link again.
        """
        if not isinstance(item, Ended):
            self._inbox.put(item)
            return
        with self._lock:
            is_lost = item.error is not None and not self._is_closing
            if not is_lost:
                return  # `close` puts the only Ended item of this source.
        self._lost_ns = monotonic_ns()
        self.is_lost = True
        self._tell(f"{item.error} It is opened again when it is back")
        self._wanted.set()

    def first(self) -> AbstractContextManager[None]:
        """Return the context in which the consumer of the inbox waits while the source fetches."""
        return self._heard.first()

    def _keep(self) -> None:
        while True:
            self._wanted.wait()
            if self._is_closing:
                return
            self._source.close()
            self._wanted.clear()
            if not self._reopen():
                return

    def _reopen(self) -> bool:
        """Try to open the link again until that succeeds, and return True.

        Returns False as soon as this source is to end.
        """
        pause_s = FIRST_LOOK_S
        while not self._must_end_within(pause_s):
            places = self._places()
            if places is None:
                pause_s = min(2 * pause_s, ABSENT_LOOK_S)
                continue
            self._source = self._make(self, places)
            if self._opens():
                self.is_lost = False
                away_s = (monotonic_ns() - self._lost_ns) / 1e9
                moved = [place for port, place in places.items() if place != port]
                where = f" as {', '.join(moved)}" if moved else ""
                self._tell(f"{self._link}: is back{where} after {away_s:.1f} s; listening goes on")
                return True
            pause_s = min(2 * pause_s, LAST_LOOK_S)
        return False

    def _must_end_within(self, pause_s: float) -> bool:
        """Wait for `pause_s` seconds; return True, even earlier, if this source is to end."""
        self._wanted.wait(pause_s)
        return self._is_closing

    def _opens(self) -> bool:
        try:
            self._source.open()
        except (LinkError, OSError):  # OSError: the interface is still down.
            self._source.close()
            return False
        return True

    def _places(self) -> dict[str, str] | None:
        """Return the present path of each port of a serial link, by its path in the link.

        Returns None if a port is not there, an empty dictionary for a network interface.
        """
        if not isinstance(self._link, SerialLink):
            return {}
        places = {}
        for port in self._link.ports:
            place = find_port(port, self._identities.get(port))
            if place is None:
                return None
            places[port] = place
        return places

    def _tell(self, message: str) -> None:
        self._inbox.put(
            WireEvent(ts_ns=now_ns(), link=self.link, kind=EventKind.GAP, message=message)
        )


# Two serial ports as one live source: one receives the master's bytes, the other the slaves'.
#
# Each port has a reading process and a thread of its own; each chunk says which side sent it. A
# Quiet item means that all bytes received before its time are in the inbox. Each port knows this
# only for itself, so this source puts a Quiet with the earlier of the two times. When the clock is
# set back, these times go back, too. When one port is gone, the other one is ended, too; its last
# bytes come before the Ended of this source.


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
                self._tell_quiet()

    def _tell_quiet(self) -> None:
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


def live_source(
    link: LinkSpec,
    inbox: Inbox,
    *,
    ports: Sequence[int] = (MODBUS_PORT,),
    allowed: AllowedPeers = THIS_MACHINE,
    returns: bool = False,
) -> LiveSource[Any]:
    """Return the source for a link, not yet open.

    `ports` are the TCP ports whose packets are captured from an interface; an empty list means all
    ports. `allowed` are the machines that may connect to a tap. With `returns`, a serial port or an
    interface that is lost is opened again when it is back. Raises UsageError for a link that cannot
    be captured.
    """
    if returns and isinstance(link, SerialLink | InterfaceLink):
        return ReturningSource(link, inbox, partial(_source, link, ports))
    match link:
        case SerialLink() | InterfaceLink():
            return _source(link, ports, inbox, {})
        case TapLink():
            from mbtool.sources.tap import TapSource

            return TapSource(link, inbox, allowed=allowed, waits=True)
        case AutoLink():
            raise UsageError(f"link {link}: its settings are to be found first (guess_line)")
        case TcpLink():
            free = 1503 if link.endpoint.port == 1502 else 1502
            raise UsageError(
                f"link {link}: an endpoint cannot be listened to; put a tap before it "
                f"(tap:127.0.0.1:{free}={link.endpoint}) or capture its interface (net:eth0)"
            )


def _source(
    link: SerialLink | InterfaceLink,
    ports: Sequence[int],
    inbox: PatientSink,
    places: Mapping[str, str],
) -> LiveSource[Any]:
    match link:
        case SerialLink(slave_port=str(), is_relay=False):
            return TwoTapsSource(link, inbox, places=places)
        case SerialLink():
            from mbtool.sources.serial_capture import SerialSource

            return SerialSource(link, inbox, places=places)
        case InterfaceLink():
            from mbtool.sources.interface import InterfaceSource

            return InterfaceSource(link, inbox, ports=ports)
