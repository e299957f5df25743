"""The transactions and events made of blocks are those that the decoder makes."""

from __future__ import annotations

import random

import pytest

from mbtool.columns.plain_records import plain_records
from mbtool.devices import Namer
from tests.columns.both_ways import blocks_of, damaged, records_of
from tests.columns.disturbed_captures import disturbed


@pytest.mark.parametrize("number", range(8))
def test_disturbed_captures_give_equal_records(number: int) -> None:
    capture = damaged(disturbed(number), random.Random(number))
    blocks, error, _ = blocks_of(capture, 100 if number % 2 else 65_536)
    namer = Namer()
    found = [one for block in blocks for one in plain_records(block, namer)]
    assert (found, error) == records_of(capture)
