"""Makes a transaction object from one row of the arrays, equal to the one that the Decoder would
make.
"""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING, Any, NamedTuple

from mbtool.columns.plain_rows import link_addresses_of
from mbtool.core import Direction, Origin
from mbtool.decode.transactions import Ends, add_origins, with_response
from mbtool.modbus.adu import Adu, DirectionBy, Transport
from mbtool.modbus.adu_bytes import MBAP_BYTES
from mbtool.packets.link_addresses import MAX_CACHED_HEADERS

if TYPE_CHECKING:
    from mbtool.columns.arrays import Int64s
    from mbtool.columns.plain_rows import PlainRows
    from mbtool.core import LinkAddresses
    from mbtool.modbus.transaction import Transaction


def plain_transaction(rows: PlainRows, index: int) -> Transaction:
    """Return the transaction with this index in the arrays, as the Decoder would make it from
    packets.
    """
    identity = rows.connections[rows.connection[index]]
    ends = Ends(identity.link, str(identity.master), str(identity.slave))
    request = _adu(
        rows,
        Direction.REQUEST,
        index,
        _Half(
            rows.request, rows.request_ip_at, rows.request_begin, rows.request_size, rows.request_ns
        ),
    )
    response = _adu(
        rows,
        Direction.RESPONSE,
        index,
        _Half(
            rows.response,
            rows.response_ip_at,
            rows.response_begin,
            rows.response_size,
            rows.response_ns,
        ),
    )
    return with_response(ends, request, response, 0, ())


@lru_cache(maxsize=MAX_CACHED_HEADERS)
def origin_fields(
    request: LinkAddresses | None, response: LinkAddresses | None
) -> tuple[str | None, str | None, int | None]:
    """Return the MAC address of the master, that of the slave, and the VLAN number; None for what
    is unknown.

    `request` and `response` are the addresses in the headers of the two packets; None if a header
    has none.
    """
    fields: dict[str, Any] = {}
    add_origins(fields, Origin("", 0, request), Origin("", 0, response))
    return fields.get("source_mac"), fields.get("destination_mac"), fields.get("vlan")


class _Half(NamedTuple):
    """Fields of all requests, or of all responses, as arrays with an element per transaction.

    `packet` is the packet's index in the block, `ip_at` the length of its link layer header in
    bytes. The ADU has `size` bytes from the offset `begin` of the block's bytes on; `ts_ns` is its
    time in UTC ns.
    """

    packet: Int64s
    ip_at: Int64s
    begin: Int64s
    size: Int64s
    ts_ns: Int64s


def _adu(rows: PlainRows, direction: Direction, index: int, half: _Half) -> Adu:
    packet, ip_at, begin, size, ts_ns = (int(values[index]) for values in half)
    block = rows.block
    raw = rows.data[begin : begin + size].tobytes()
    addresses = link_addresses_of(block, packet, ip_at)
    return Adu(
        start_ns=ts_ns,
        end_ns=ts_ns,
        transport=Transport.TCP,
        direction=direction,
        direction_by=DirectionBy.PORT,
        confidence=1.0,
        unit=raw[6],
        pdu=raw[MBAP_BYTES:],
        raw=raw,
        transaction_id=raw[0] << 8 | raw[1],
        origin=Origin(block.file, block.first_number + packet, addresses),
    )
