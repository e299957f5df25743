"""The measurement of the size of logs, on a few polls."""

from __future__ import annotations

from mbtool.core import Chunk
from tests.benchmarks.log_size import block, sizes


def test_a_block_holds_times_lengths_and_bytes() -> None:
    reads = [
        Chunk(ts_ns=5_000_000, link="a", data=b"\x01\x03"),
        Chunk(ts_ns=8_009_000, link="a", data=b"\x04"),
    ]
    # 3.009 ms are 300 times 10 us: ac 02, seven bits at a time.
    assert block(reads) == bytes.fromhex("05  00 02  ac02 01  010304")


def test_evidence_alone_is_smaller_and_in_blocks_smaller_still() -> None:
    whole, evidence, blocks, long_blocks = sizes(10, 100, by_byte=True)
    assert whole > evidence > blocks > long_blocks
