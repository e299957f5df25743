"""After a plain stretch the decoder knows what it would know of its packets one by one.

A new field of these classes that a stretch changes fails here: let `pass_plain` set it, or let
`is_at_rest` be False where it counts.
"""

from __future__ import annotations

from typing import Any

import pytest

from mbtool.columns.column_decoder import ColumnDecoder
from mbtool.columns.packet_block import _block_of
from mbtool.decode.decoder import Decoder
from mbtool.devices import Namer
from mbtool.packets.connection import TcpConnection
from mbtool.packets.stream import Stream
from tests.columns.both_ways import PORTS
from tests.columns.test_equality import READ, VALUES, poll
from tests.packets.building import Talk


def known(decoder: Decoder) -> dict[str, Any]:
    """All that a decoder with one connection knows of it."""
    (connection,) = decoder.reassembler._connections.values()
    assert isinstance(connection, TcpConnection)
    (detector,) = decoder._detectors.values()
    inner = detector._candidates[0].decoder
    pairing = vars(inner._pairing) | {"_habits": vars(inner._pairing._habits)}
    pairing["_unanswered"] = len(inner._pairing._unanswered)
    for name in ("_ends", "_dropped", "_readings"):
        del pairing[name]
    (reading,) = inner._pairing._readings
    return {
        "connection": slots_of(connection, TcpConnection, {"_out", "_directions", "_prober"}),
        "streams": [slots_of(one, Stream, set()) for one in connection._directions[0]],
        "pairing": pairing,
        "reading": {name: getattr(reading, name) for name in type(reading).__slots__},
        "progress": [vars(one) for one in inner._progress.values()],
        "last": (inner._last_ns, decoder._last_ns, decoder.reassembler._checked_ns),
    }


def slots_of(one: object, kind: type, without: set[str]) -> dict[str, Any]:
    names = [name for name in kind.__slots__ if name not in without]  # type: ignore[attr-defined]
    return {name: getattr(one, name) for name in names}


@pytest.mark.parametrize("transactions", [2, 3, 12, 200])
@pytest.mark.parametrize("varied", [False, True])
def test_the_decoder_knows_the_same(transactions: int, varied: bool) -> None:
    talk = Talk()
    packets = [*talk.handshake(), *poll(talk, transactions, READ, VALUES)]
    if varied:
        write = bytes.fromhex("06 0001 0002")
        packets += [*poll(talk, 2, write, write), *poll(talk, 2), talk.request(b"")]
    one, other = (Decoder(Namer(), ports=PORTS, across=True) for _ in range(2))
    for packet in packets:
        one.feed(packet)
    columns = ColumnDecoder(other, PORTS)
    assert len([*columns.feed(_block_of(packets))]) == 1
    assert columns.plain_rows == transactions - 1 + 4 * varied
    assert known(one) == known(other)
