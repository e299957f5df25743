"""A live source that opens its port or interface again when it comes back after it was lost."""

# A source ends with an error when its adapter is unplugged or its interface goes down. Then this
# source puts a GAP event, closes the lost source, and tries to open the link again: after 0.25 s,
# then after twice as long each time, up to 5 s while the link is there but cannot be opened, and up
# to 1 s while it is not there, as looking into /dev costs little. A serial port is found under
# another name, too (ports/local_ports.py). When the link is open again, another GAP event says
# how long it was away. All items keep the name of the link.
#
# If the first opening fails, it is not repeated: a link that is absent at the start is probably a
# mistake of the user.

from __future__ import annotations

from collections.abc import Callable, Mapping
from threading import Event, Lock
from typing import TYPE_CHECKING, Any

from mbtool.core import EventKind, InterfaceLink, LinkError, SerialLink, WireEvent
from mbtool.ports.clock import monotonic_ns, now_ns
from mbtool.ports.local_ports import PortIdentity, find_port, identity_of
from mbtool.sources.inbox import Ended, Inbox, Item
from mbtool.sources.source import LiveSource

if TYPE_CHECKING:
    from contextlib import AbstractContextManager

    MakeSource = Callable[[Any, Mapping[str, str]], LiveSource[Any]]
    """A function that creates a source. Its first argument is the sink for the source's items. The
    second gives the present path of a port for each path in the link; it is empty at first."""

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
        self._report(f"{item.error} It is opened again when it is back")
        self._wanted.set()

    def fetching_first(self) -> AbstractContextManager[None]:
        """Return the context in which the consumer of the inbox waits while the source fetches."""
        return self._heard.fetching_first()

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
                self._report(
                    f"{self._link}: is back{where} after {away_s:.1f} s; listening goes on"
                )
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

    def _report(self, message: str) -> None:
        self._inbox.put(
            WireEvent(ts_ns=now_ns(), link=self.link, kind=EventKind.GAP, message=message)
        )
