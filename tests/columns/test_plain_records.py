"""The transactions and events made of blocks are those that the decoder makes."""

from __future__ import annotations

import random
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING
from unittest.mock import patch

import pytest

from mbtool.columns import plain_transactions
from mbtool.columns.plain_records import plain_records
from mbtool.columns.plain_transactions import PlainObjects
from tests.benchmarks.file_workloads import make_capture, random_requests, scan
from tests.columns.both_ways import blocks_of, damaged, namer_of, records_of
from tests.columns.disturbed_captures import disturbed
from tests.columns.test_equality import every_form

if TYPE_CHECKING:
    from pathlib import Path

Frames = Callable[[int, random.Random], Iterator[tuple[bytes, int]]]


PROFILES = (None, "fa3-at1m8x", "wago-750", "idec-ft1a-touch")


def assert_equal(capture: bytes, block_packets: int, profile: str | None) -> None:
    blocks, error, _ = blocks_of(capture, block_packets, namer_of(profile))
    objects = PlainObjects(namer_of(profile))
    found = [one for block in blocks for one in plain_records(block, objects)]
    expected, expected_error = records_of(capture, namer_of(profile))
    assert error == expected_error
    for one, other in zip(found, expected, strict=True):
        assert one == other


@pytest.mark.parametrize("profile", PROFILES)
@pytest.mark.parametrize("number", range(8))
def test_disturbed_captures_give_equal_records(number: int, profile: str | None) -> None:
    capture = damaged(disturbed(number), random.Random(number))
    assert_equal(capture, 100 if number % 2 else 65_536, profile)


@pytest.mark.parametrize("profile", PROFILES)
@pytest.mark.parametrize("most", [3, 65_536])
def test_requests_of_every_form_give_equal_records(profile: str | None, most: int) -> None:
    with patch.object(plain_transactions, "MAX_KINDS", most):
        assert_equal(every_form(), 65_536, profile)


@pytest.mark.parametrize("profile", PROFILES)
@pytest.mark.parametrize("frames", [random_requests, scan])
@pytest.mark.parametrize("at_once", [7, 4096])
def test_many_different_requests_give_equal_records(
    frames: Frames, profile: str | None, at_once: int, tmp_path: Path
) -> None:
    made = make_capture(tmp_path / "many.pcap", frames, 1500)
    with patch.object(plain_transactions, "AT_ONCE", at_once):
        assert_equal(made.path.read_bytes(), 1000, profile)
