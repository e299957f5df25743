"""Makes the transaction of one plain row as the decoder makes it, for PDUs of unusual form."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mbtool.core import Direction
from mbtool.decode.transactions import Ends, with_response
from mbtool.modbus.adu import Adu, DirectionBy, Transport
from mbtool.modbus.adu_bytes import MBAP_BYTES

if TYPE_CHECKING:
    from mbtool.columns.column_decoder import PlainRows
    from mbtool.modbus.transaction import Transaction


def plain_transaction(rows: PlainRows, index: int) -> Transaction:
    """The transaction of the row at an index."""
    identity = rows.connections[rows.connection[index]]
    ends = Ends(identity.link, str(identity.master), str(identity.slave))
    request = _adu(
        rows,
        Direction.REQUEST,
        int(rows.request_begin[index]),
        int(rows.request_size[index]),
        int(rows.request_ns[index]),
    )
    response = _adu(
        rows,
        Direction.RESPONSE,
        int(rows.response_begin[index]),
        int(rows.response_size[index]),
        int(rows.response_ns[index]),
    )
    return with_response(ends, request, response, 0, ())


def _adu(rows: PlainRows, direction: Direction, begin: int, size: int, ts_ns: int) -> Adu:
    raw = rows.block.data[begin : begin + size].tobytes()
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
    )
