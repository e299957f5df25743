"""What tests ask of the events of a splitter, of Bus and of Conversation."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from mbtool.core import WireEvent
from mbtool.modbus import Adu, Decoded, Skipped, Transaction

if TYPE_CHECKING:
    from collections.abc import Iterable


def raw(events: Iterable[Adu | Skipped]) -> bytes:
    """Every byte of the events, in order."""
    return b"".join(event.raw for event in events)


def adus(events: Iterable[Any]) -> list[Adu]:
    return [event for event in events if isinstance(event, Adu)]


def skipped(events: Iterable[Adu | Skipped]) -> list[Skipped]:
    return [event for event in events if isinstance(event, Skipped)]


def transactions(decoded: Iterable[Decoded]) -> list[Transaction]:
    return [one for one in decoded if isinstance(one, Transaction)]


def wire_events(decoded: Iterable[Decoded]) -> list[WireEvent]:
    return [one for one in decoded if isinstance(one, WireEvent)]


def pdus(events: Iterable[Adu | Skipped]) -> list[tuple[int, str]]:
    """Unit and PDU of each ADU."""
    return [(adu.unit, adu.pdu.hex()) for adu in adus(events)]
