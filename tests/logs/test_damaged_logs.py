"""What is read of logs that were cut off or damaged, beside the stock reader.

A small part of what `python -m tests.benchmarks.damaged_logs` tries.
"""

from __future__ import annotations

import io
import random
from typing import TYPE_CHECKING

import pytest

from mbtool.core import InputError
from mbtool.logs.layout import MAGIC, RECORD_HEAD, Opcode
from mbtool.logs.recovery import Recovery
from tests.benchmarks.damaged_logs import (
    cuts,
    flips,
    logs,
    read_items,
    recovered,
    stock_messages,
    survey,
)
from tests.logs.samples import records_of

if TYPE_CHECKING:
    from pathlib import Path

NAMES = ("serial", "tap", "packets", "killed")


@pytest.mark.parametrize("name", NAMES)
def test_a_changed_bit_costs_no_message_but_those_of_its_chunk(tmp_path: Path, name: str) -> None:
    data = logs(tmp_path)[name]
    found = survey(data, flips(data, step=2503), tmp_path)
    assert found.tried > 20
    assert (found.wrong, found.behind_stock) == ([], [])
    # The first bytes say that the file is a log at all.
    assert {one for one in found.not_whole if not one.endswith(" byte 0")} == set()


@pytest.mark.parametrize("name", NAMES)
def test_a_cut_costs_no_message_before_it(tmp_path: Path, name: str) -> None:
    data = logs(tmp_path)[name]
    found = survey(data, cuts(data, step=997), tmp_path)
    assert found.tried > 8
    assert (found.wrong, found.behind_stock, found.not_whole) == ([], [], [])


@pytest.mark.parametrize("name", NAMES)
def test_damage_of_many_bytes_costs_no_message_of_another_chunk(tmp_path: Path, name: str) -> None:
    data = logs(tmp_path)[name]
    chunks = records_of(data, Opcode.CHUNK)
    chance = random.Random(1)
    changes = []
    for number in range(8):
        at = chance.randrange(len(MAGIC), len(data))
        size = chance.choice((2, 9, 64, 512))
        new = chance.choice((bytes(size), chance.randbytes(size)))
        broken = {
            number
            for number, (offset, length) in enumerate(chunks)
            if at < offset + RECORD_HEAD.size + length and offset < at + size
        }
        changes.append((f"{number}", data[:at] + new + data[at + size :], broken))
    found = survey(data, iter(changes), tmp_path)
    assert found.wrong == []
    # A profile or the settings may be hit, which costs no message.
    assert found.not_whole == []


def test_bytes_in_front_of_a_log_and_bytes_missing_in_it_cost_one_chunk(tmp_path: Path) -> None:
    data = logs(tmp_path)["serial"]
    offset, _ = records_of(data, Opcode.CHUNK)[2]
    without = data[: offset + 100] + data[offset + 300 :]
    whole = len(stock_messages(data))
    assert whole > len(recovered(without, tmp_path)) >= whole - 40
    assert len(recovered(b"junk" * 100 + data, tmp_path)) == whole


def test_a_file_of_false_heads_is_searched_in_bounded_time(tmp_path: Path) -> None:
    head = MAGIC + logs(tmp_path)["serial"][len(MAGIC) : 200]
    for false in (
        RECORD_HEAD.pack(Opcode.CHUNK, 40_000_000) + bytes(28) + b"\4\0\0\0zstd",
        RECORD_HEAD.pack(Opcode.ATTACHMENT, 60_000_000) + bytes(20),
        RECORD_HEAD.pack(Opcode.METADATA, 9) + b"\1\0\0\0a\0\0\0\0",
        RECORD_HEAD.pack(Opcode.MESSAGE_INDEX, 6) + bytes(6),
        bytes(9),
        b"\6",
    ):
        data = head + false * (100_000 // len(false))
        assert read_items(data) == []
        with pytest.raises(InputError):
            Recovery(io.BytesIO(data[300:]), "x.mcap", print).run(tmp_path / "good.mcap")
