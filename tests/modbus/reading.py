"""Functions that tests use to read the events of splitters and decoders."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from mbtool.core import WireEvent
from mbtool.modbus.adu import Adu, Skipped
from mbtool.modbus.transaction import Transaction

if TYPE_CHECKING:
    from collections.abc import Iterable

    from mbtool.decode.connections import Decoded


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


def with_parity(characters: bytes, parity: str) -> bytes:
    """The bytes that a port of 8 data bits hears from a line with 7 and a parity bit.

    The parity is `even`, `odd`, `mark` or `space`.
    """
    marked = {"even": (0, 1), "odd": (1, 0), "mark": (1, 1), "space": (0, 0)}[parity]
    return bytes(each | marked[each.bit_count() & 1] << 7 for each in characters)
