"""Feeds packets to a reassembler and reads what comes out."""

from __future__ import annotations

from ipaddress import ip_address
from typing import TYPE_CHECKING

from mbtool.core import Chunk, Direction, WireEvent
from mbtool.packets.reassembler import TcpReassembler
from mbtool.packets.stream_events import (
    CloseReason,
    StreamClosed,
    StreamEvent,
    StreamGap,
    StreamItem,
)

if TYPE_CHECKING:
    from mbtool.core import Packet


def run_packets(
    packets: list[Packet], reassembler: TcpReassembler | None = None, *, close: bool = True
) -> list[StreamItem]:
    reassembler = reassembler or TcpReassembler()
    items = [item for each in packets for item in reassembler.feed(each)]
    return items + (reassembler.close(packets[-1].ts_ns) if close and packets else [])


def words_of(items: list[StreamItem]) -> list[str | int]:
    """Give the bytes as text behind `>` (request) or `<` (response), and a gap as its length."""
    words: list[str | int] = []
    for item in items:
        if isinstance(item, Chunk):
            words.append((">" if item.direction is Direction.REQUEST else "<") + item.data.decode())
        elif isinstance(item, StreamGap):
            words.append(item.missing)
    return words


def close_reasons(items: list[StreamItem]) -> list[CloseReason]:
    return [item.reason for item in items if isinstance(item, StreamClosed)]


def wire_events(items: list[StreamItem]) -> list[WireEvent]:
    """The events, including those of connections."""
    told = (item.event if isinstance(item, StreamEvent) else item for item in items)
    return [one for one in told if isinstance(one, WireEvent)]


def host(address: bytes) -> str:
    return str(ip_address(address))
