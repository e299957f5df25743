from __future__ import annotations

import io

import pytest
from mcap.records import Header, Metadata
from mcap.stream_reader import StreamReader

from mbtool.logs.layout import (
    FOOTER_SIZE,
    MAGIC,
    RECORD_HEAD,
    TAIL_SIZE,
    data_end,
    empty_record,
    footer,
    pack_records,
)


def test_a_tail_is_data_end_footer_and_magic() -> None:
    assert data_end(0x01020304) + footer() == bytes.fromhex(
        "0f 0400000000000000"  # DataEnd, 4 bytes
        "04030201"  # CRC
        "02 1400000000000000"  # Footer, 20 bytes
        "0000000000000000"  # no summary
        "0000000000000000"  # no summary offsets
        "00000000"  # no CRC
        "89 4d434150 30 0d0a"  # magic
    )
    assert (TAIL_SIZE, FOOTER_SIZE) == (50, 37)


@pytest.mark.parametrize("size", [RECORD_HEAD.size, 10, 600])
def test_the_stock_reader_skips_an_empty_record(size: int) -> None:
    header = Header(profile="mbtool", library="")
    after = Metadata(name="after", metadata={})
    filler = empty_record(size)
    assert len(filler) == size
    data = MAGIC + pack_records(header) + filler + pack_records(after) + data_end(0) + footer()
    names = [type(record).__name__ for record in StreamReader(io.BytesIO(data)).records]
    assert names == ["Header", "Metadata", "DataEnd", "Footer"]
