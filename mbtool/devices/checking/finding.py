"""A broken rule: what was found, where and when."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from mbtool.core import CONNECTION_JOINED
from mbtool.devices.checking.rules import Severity, severity_of

if TYPE_CHECKING:
    from mbtool.core import WireEvent
    from mbtool.devices.named_transaction import NamedTransaction


@dataclass(frozen=True, slots=True, kw_only=True)
class Finding:
    """One breaking of a rule, or what many of one kind come to."""

    code: str
    message: str
    """What happened, with its figures; one line, without the code."""
    ts_ns: int
    """When it was first to be seen."""
    link: str
    source: str | None = None
    destination: str | None = None
    unit: int | None = None
    function: int | None = None
    reference: str | None = None
    """What was addressed, in the vendor's notation."""
    device: str | None = None
    """The profile's name."""
    count: int = 1
    """How often it happened, where one finding tells of many."""

    @property
    def severity(self) -> Severity:
        return severity_of(self.code)


def found(
    code: str, transaction: NamedTransaction, message: str, *, ts_ns: int | None = None
) -> Finding:
    """A finding about a transaction."""
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
    )


def found_in(code: str, event: WireEvent, message: str | None = None) -> Finding:
    """A finding about a wire event, in its own words where no others are given."""
    return Finding(
        code=code,
        message=event.message if message is None else message,
        ts_ns=event.ts_ns,
        link=event.link,
        source=event.source or None,
        destination=event.destination or None,
    )


def is_joined(event: WireEvent) -> bool:
    """Whether a connection that is seen for the first time was open before."""
    return event.message == CONNECTION_JOINED
