"""mbtool diff."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import TYPE_CHECKING

from mbtool.cli import exit_codes
from mbtool.replay import traffic
from tests.workflows.evidence import polling_log

if TYPE_CHECKING:
    import pytest

    from tests.cli.program import CommandLine

CAPTURES = Path(__file__).resolve().parents[2] / "captures"
SETUP = CAPTURES / "fa3-at1m8x-setup.mcap"
LINE = CAPTURES / "ft1a-touch-line.mcap"
GLUED = CAPTURES / "torn-and-glued-frames.mcap"
PLANT = CAPTURES / "plant.pcap"
RETRY = CAPTURES / "retry-after-silence.mcap"


def test_equal_captures_are_told_and_the_exit_code_is_0(mbtool: CommandLine) -> None:
    told = mbtool("diff", SETUP, SETUP.with_suffix(".pcap"))
    assert (told.code, told.out) == (exit_codes.DONE, "")
    assert told.err.startswith("0 differences between 9 transactions of ")


def test_differences_are_a_table_and_the_exit_code_is_1(mbtool: CommandLine) -> None:
    told = mbtool("diff", RETRY, GLUED)
    assert told.code == exit_codes.NO
    assert [line.rstrip() for line in told.lines] == [
        "unit 1",
        "differs  function  what      A        B",
        "value    read      HR400001  1, 3, 4  4660",
        "",
    ]
    assert told.err.startswith("1 difference between ")


def test_differences_as_json(mbtool: CommandLine) -> None:
    told = mbtool("diff", RETRY, GLUED, "--format", "json")
    document = json.loads(told.out)
    assert (document["a"], document["b"]) == (str(RETRY), str(GLUED))
    assert document["differences"] == [
        {
            "kind": "value",
            "unit": 1,
            "reference": "HR400001",
            "what": "read",
            "a": {"text": "1, 3, 4", "values": [1, 3, 4]},
            "b": {"text": "4660", "values": [4660]},
        }
    ]


def test_requests_whose_latencies_changed_by_other_factors_are_named_each(
    mbtool: CommandLine, tmp_path: Path
) -> None:
    before = polling_log(tmp_path / "a.mcap", dict.fromkeys(range(6), 20))
    after = polling_log(tmp_path / "b.mcap", {0: 22, 1: 60, 2: 10, 3: 20, 4: 62, 5: 40})
    told = mbtool("diff", before, after)
    assert told.code == exit_codes.NO
    rows = [line for line in told.lines if line.startswith("latency")]
    shown = [(re.findall(r"holding \d", row), re.findall(r"(\d+) ms,", row)) for row in rows]
    assert shown == [
        (["holding 4", "holding 1"], ["20", "62"]),
        (["holding 5"], ["20", "40"]),
        (["holding 0"], ["20", "22"]),
        (["holding 2"], ["20", "10"]),
    ]


def test_what_could_not_be_compared_is_told_and_the_exit_code_is_3(
    mbtool: CommandLine, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(traffic, "MAX_SLAVES", 1)
    told = mbtool("diff", PLANT, PLANT)
    assert (told.code, told.out) == (exit_codes.UNREADABLE, "")
    assert told.err.splitlines() == [
        "mbtool: there is more than can be compared at once; choose a part with --where",
        "0 differences in the part that was compared: "
        f"22 of 63 transactions of {PLANT} and 22 of 63 of {PLANT}",
    ]
    document = json.loads(mbtool("diff", PLANT, PLANT, "--format", "json").out)
    assert (document["is_whole"], document["a_compared"]) == (False, 22)


def test_a_line_feed_in_the_name_of_a_file_is_escaped(mbtool: CommandLine, tmp_path: Path) -> None:
    odd = tmp_path / "two\nlines.mcap"
    odd.write_bytes(SETUP.read_bytes())
    told = mbtool("diff", odd, odd)
    assert told.err.count("two\\nlines.mcap") == 2
    assert len(told.err.splitlines()) == 1


def test_registers_can_be_left_out(mbtool: CommandLine) -> None:
    assert mbtool("diff", RETRY, GLUED, "--ignore", "HR400001").code == exit_codes.DONE


def test_a_wrong_range_is_wrong_usage(mbtool: CommandLine) -> None:
    told = mbtool("diff", RETRY, GLUED, "--ignore", "RWr2")
    assert (told.code, told.out) == (exit_codes.USAGE, "")
    assert "'RWr2' is no range of registers; write 'holding 10..20'" in told.err


def test_a_file_that_is_not_there_cannot_be_read(mbtool: CommandLine) -> None:
    assert mbtool("diff", SETUP, "nowhere.pcap").code == exit_codes.UNREADABLE
