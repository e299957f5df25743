"""A finding of `mbtool check`: says which rule is broken, where and when."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from mbtool.core import CONNECTION_JOINED, WireEvent
from mbtool.devices.checking.rules import Severity, severity_of

if TYPE_CHECKING:
    from mbtool.devices.named_transaction import NamedTransaction


@dataclass(frozen=True, slots=True, kw_only=True)
class Finding:
    """One case of a broken rule, or a summary of many cases of one kind."""

    code: str
    message: str
    """A line that says what happened, with figures, but without the code."""
    ts_ns: int
    """The time of the first case, in ns since 1970."""
    link: str
    source: str | None = None
    destination: str | None = None
    unit: int | None = None
    function: int | None = None
    reference: str | None = None
    """The addresses of the request, in the vendor's notation; None if there are none."""
    device: str | None = None
    """The name of the slave's profile; None if the slave has none."""
    count: int = 1
    """The number of times that the rule was broken like this; the finding stands for all."""

    file: str | None = None
    """The capture file of the first case, as the user named it; None if it is not known."""
    packets: tuple[int, ...] = ()
    """The numbers of the first case's packets in its file, from 1, as Wireshark counts them."""
    offsets: tuple[int, ...] = ()
    """In a file of the bytes of a serial line, the numbers of bytes before the first case's request
    and response."""
    cases: tuple[tuple[int, ...], ...] = ()
    """The packet numbers of request and response of each case of an attack or a scan."""
    level: Severity | None = None
    """The severity of a trouble that breaks no rule; if None, that of the rule of `code`."""

    @property
    def severity(self) -> Severity:
        return self.level or severity_of(self.code)


def transaction_finding(
    code: str, transaction: NamedTransaction, message: str, *, ts_ns: int | None = None
) -> Finding:
    """Make a finding with the code of a rule about a transaction.

    Its time is `ts_ns`, or the transaction's start if that is None.
    """
    return Finding(
        code=code,
        message=message,
        ts_ns=transaction.start_ns if ts_ns is None else ts_ns,
        link=transaction.link,
        source=transaction.source,
        destination=transaction.destination,
        unit=transaction.unit,
        function=transaction.function,
        reference=transaction.reference,
        device=transaction.device,
        file=transaction.file,
        packets=packets_of(transaction),
        offsets=_without_none(transaction.request_offset, transaction.response_offset),
    )


def packets_of(transaction: NamedTransaction) -> tuple[int, ...]:
    """Return the numbers of the packets of request and response, as far as they are known."""
    request, response = transaction.request_packet, transaction.response_packet
    if request is not None and response is not None:
        return request, response  # The usual case.
    return _without_none(request, response)


def _without_none(*numbers: int | None) -> tuple[int, ...]:
    return tuple(number for number in numbers if number is not None)


def event_finding(code: str, event: WireEvent, message: str | None = None) -> Finding:
    """Make a finding with the code of a rule about a wire event.

    If `message` is None, the finding has the message of the event.
    """
    return Finding(
        code=code,
        message=event.message if message is None else message,
        ts_ns=event.ts_ns,
        link=event.link,
        source=event.source or None,
        destination=event.destination or None,
    )


def is_joined(event: WireEvent) -> bool:
    """True if the event says that its connection was already open when the capture began."""
    return event.message == CONNECTION_JOINED
