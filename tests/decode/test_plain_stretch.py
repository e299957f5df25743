"""Requests of a plain stretch, made from their bytes."""

from __future__ import annotations

from mbtool.core import Direction
from mbtool.decode.plain_stretch import plain_request
from mbtool.framing import MbapSplitter
from mbtool.modbus.adu import mbap_adu


def test_request_of_a_plain_stretch_is_the_one_that_its_stream_gives() -> None:
    raw = mbap_adu(0x1234, 0x11, bytes.fromhex("03 006B 0003"))
    assert [plain_request(raw, 5)] == MbapSplitter(Direction.REQUEST).feed(raw, 5)
