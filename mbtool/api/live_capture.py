"""Listens on links from Python."""

from __future__ import annotations

import threading
from collections.abc import AsyncIterator, Callable, Iterator, Sequence
from functools import partial
from math import inf
from os import fspath
from typing import Self

from mbtool.api.arguments import AnyPath, Devices, assignments_of, condition_of
from mbtool.core import WireEvent, parse_link
from mbtool.core.limits import MODBUS_PORT
from mbtool.core.link_spec import HEARD
from mbtool.decode.decoder import Decoder, Record
from mbtool.decode.line_timing import LineTiming
from mbtool.devices import NamedTransaction, Namer
from mbtool.ports.clock import now_ns
from mbtool.ports.tcp_listener import AllowedPeers
from mbtool.workflows.sniff import Sniffer, serial_lines, with_settings


class LiveCapture:
    """Transactions and events heard on links while its `with` block runs; `mbtool.sniff` makes it.

    The end of the block completes the log, if there is one.
    """

    def __init__(
        self,
        make_sniffer: Callable[[Callable[[str], None]], Sniffer],
        wanted: Callable[[NamedTransaction], bool],
    ) -> None:
        self._make_sniffer = make_sniffer
        self._wanted = wanted
        self._stopping = threading.Event()
        self._sniffer: Sniffer | None = None
        self._stream: Iterator[Record] = iter(())
        """The only iterator over the records. All calls of `records` and `transactions` take from
        it, so that no record is lost between two calls."""
        self._end_ns = inf
        """The time at which the current call of `records` or `transactions` ends, in ns since 1970;
        infinite if the call has no time limit."""
        self.remarks: list[str] = []
        """Lines about the links, such as that bytes were lost or a master was turned away."""

    @property
    def places(self) -> list[str]:
        """The open links as text; a tap with port 0 shows the port that the system chose."""
        return [] if self._sniffer is None else self._sniffer.places

    def __enter__(self) -> Self:
        sniffer = self._make_sniffer(self.remarks.append)
        sniffer.__enter__()
        self._sniffer = sniffer
        self._stream = sniffer.records(self._is_over)
        return self

    def __exit__(self, *error: object) -> None:
        sniffer, self._sniffer = self._sniffer, None
        if sniffer is not None:
            sniffer.__exit__(*error)

    def __iter__(self) -> Iterator[NamedTransaction]:
        return self.transactions()

    def __aiter__(self) -> AsyncIterator[NamedTransaction]:
        """Yield transactions as they end, to `async for`; a thread waits for them.

        Cancelling the task that waits ends the listening for good, as `stop` does.
        """
        return self._awaited()

    async def _awaited(self) -> AsyncIterator[NamedTransaction]:
        import asyncio  # Slow to import; most programs listen without it.

        heard = self.transactions()
        try:
            while (one := await asyncio.to_thread(next, heard, None)) is not None:
                yield one
        except asyncio.CancelledError:
            self.stop()
            raise

    def transactions(
        self, *, seconds: float | None = None, count: int | None = None
    ) -> Iterator[NamedTransaction]:
        """Yield transactions as they end: for `seconds`, until there are `count`, or for ever.

        When the time is over or `stop` was called, listening ends for good; after `count`
        transactions, or a `break`, one can go on with another call. Raises LinkError when the last
        link is lost.
        """
        if count is not None and count <= 0:
            return
        given = 0
        for record in self.records(seconds=seconds):
            if not isinstance(record, WireEvent):
                given += 1
                yield record
                if given == count:
                    return

    def records(self, *, seconds: float | None = None) -> Iterator[Record]:
        """Yield transactions and events for `seconds`, or without end.

        When the time is over or `stop` was called, listening ends for good. Raises LinkError when
        the last link is lost.
        """
        if self._sniffer is None:
            raise RuntimeError("enter the capture first: with mbtool.sniff(...) as capture")
        self._end_ns = inf if seconds is None else now_ns() + seconds * 1e9
        for record in self._stream:
            if isinstance(record, WireEvent) or self._wanted(record):
                yield record

    def _is_over(self, at_ns: int) -> bool:
        return self._stopping.is_set() or at_ns >= self._end_ns

    def stop(self) -> None:
        """End the listening, from any thread; records heard so far are still yielded."""
        self._stopping.set()


def sniff(
    link: str,
    *more: str,
    devices: Devices | None = None,
    where: str | None = None,
    log: AnyPath | None = None,
    overwrite: bool = False,
    ports: Sequence[int] = (MODBUS_PORT,),
    rtu_ports: Sequence[int] = (),
    any_port: bool = False,
    allow: Sequence[str] = (),
) -> LiveCapture:
    """Listen on links (docs/links.md): "rtu:/dev/ttyUSB0@19200-8E1", "net:eth0", "tap:...=...".

    Use it in a `with` block. `log` names a file (.mcap) to which all that is heard is written;
    `where` chooses the transactions that are yielded. `devices` gives slaves their profiles.
    `allow` names networks: a tap serves masters of these and of this machine. `ports`, `rtu_ports`
    and `any_port` are for interfaces.

    Raises UsageError for an argument that is wrong; entering the block raises LinkError for a link
    that cannot be opened.
    """
    links = [parse_link(one, HEARD) for one in (link, *more)]
    serial_lines(links)
    timing = LineTiming(assignments_of(devices))
    wanted = condition_of(where)
    allowed = AllowedPeers.parse(allow)

    def make_sniffer(on_remark: Callable[[str], None]) -> Sniffer:
        specs = timing.given(with_settings(links, on_remark))
        begin = None
        if log is not None:
            from mbtool.logs.opening import create_log

            begin = partial(
                create_log,
                fspath(log),
                specs,
                timing.assignments,
                ports=ports,
                rtu_ports=rtu_ports,
                any_port=any_port,
                overwrite=overwrite,
            )
        decoder = Decoder(
            Namer(timing.assignments),
            lines=serial_lines(specs),
            timing=timing,
            ports=ports,
            rtu_ports=rtu_ports,
            any_port=any_port,
        )
        followed = [] if any_port else [*ports, *rtu_ports]
        return Sniffer(
            specs,
            decoder,
            begin_log=begin,
            ports=followed,
            allowed=allowed,
            on_remark=on_remark,
        )

    return LiveCapture(make_sniffer, wanted)
