from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from mbtool.cli import exit_codes

if TYPE_CHECKING:
    from tests.cli.program import CommandLine

FOLDER = Path(__file__).resolve().parents[2] / "captures"
LINE = FOLDER / "ft1a-touch-line.mcap"
RETRY = FOLDER / "retry-after-silence.mcap"
NETWORK = FOLDER / "polling-with-exceptions.mcap"


def test_the_verdict_comes_first_and_tables_have_fixed_widths(mbtool: CommandLine) -> None:
    told = mbtool("stats", RETRY)
    assert told.code == exit_codes.DONE
    assert told.lines == [
        "rtu rs485 19200-8E1, unit 1 idec-ft1a-touch: 4 requests in 341 ms (11.7/s), 75 % answered",
        "! unit 1 leaves 1 of its 4 requests (25 %) without an answer: check its cable, and if the "
        "master's time-out is long enough; see what was sent before each case (UNIT-MISSING)",
        "waiting for missing answers took 87 % of the line's time",
        "",
        "line: busy 9.9 %, waits for slaves 2.5 %, for missing answers 87 %, free 0.8 %",
        "",
        "polls: failed, slowest                     asked every s  +-ms p50 ms   p95   p99   max"
        "  exc miss   line",
        "1 03 HR400001..400002                          4  varies     -    2.8   3.0   3.0   3.0"
        "         1 99.2 %",
    ]


def test_the_load_of_a_log_follows_from_its_bytes(mbtool: CommandLine) -> None:
    rows = [json.loads(line) for line in mbtool("decode", LINE, "--format", "jsonl").lines]
    count = sum(len(row[side]) // 2 for row in rows for side in ("request_raw", "response_raw"))
    watched_s = (rows[-1]["response_ns"] - rows[0]["request_ns"]) / 1e9
    (link,) = json.loads(mbtool("stats", LINE, "--json").out)["links"]
    load = link["load"]
    assert load["busy_share"] == pytest.approx(count * 11 / 19200 / watched_s, rel=1e-4)
    assert load["slaves_share"] == pytest.approx(
        sum(row["latency_ns"] for row in rows) / 1e9 / watched_s
    )
    shares = ("characters", "other_bytes", "slaves", "missing", "pauses")
    assert sum(load[f"{one}_share"] for one in shares) == pytest.approx(1)


def test_the_document_says_what_was_asked_for(mbtool: CommandLine) -> None:
    document = json.loads(mbtool("stats", NETWORK, "--json", "--where", "function == 3").out)
    assert (document["schema"], document["sources"]) == (1, [str(NETWORK)])
    assert (document["where"], document["transactions"]) == ("function == 3", 10)
    assert (document["is_whole"], document["remarks"]) == (True, [])
    (link,) = document["links"]
    assert (link["link"], link["transport"], link["settings"]) == ("127.0.0.1:39745", "tcp", None)
    assert link["load"] is None
    assert link["exceptions"] == [{"code": 2, "name": "illegal data address", "count": 2}]
    assert link["connections"][0]["opened"] == 1


def test_top_limits_the_rows_of_each_table(mbtool: CommandLine) -> None:
    few = mbtool("stats", LINE, "--top", "2").lines
    assert sum(line.startswith("1 ") for line in few) == 2
    assert "  ... 7 more polls; --top 9 shows all" in few
    many = mbtool("stats", LINE, "--top", "50").lines
    assert not any("more" in line for line in many)


def test_a_filter_that_lets_nothing_pass_says_so(mbtool: CommandLine) -> None:
    told = mbtool("stats", LINE, "--where", "unit == 99")
    assert (told.code, told.out) == (exit_codes.DONE, "")
    assert told.err == "no transactions pass --where\n"


def test_a_file_that_is_absent_hides_no_other(mbtool: CommandLine, tmp_path: Path) -> None:
    told = mbtool("stats", tmp_path / "absent.pcap", LINE, "--json")
    assert told.code == exit_codes.UNREADABLE
    assert json.loads(told.out)["transactions"] == 11
    assert "there is no such file" in told.err


def test_a_cut_capture_is_counted_up_to_its_end(
    mbtool: CommandLine, tmp_path: Path, capture: Path
) -> None:
    cut = tmp_path / "cut.pcap"
    cut.write_bytes(capture.read_bytes()[:-5])
    told = mbtool("stats", cut)
    assert told.code == exit_codes.UNREADABLE
    assert told.lines[0].startswith("tcp ")
    assert told.err.endswith("whole packets\n")
    told = mbtool("stats", cut, "--json")
    document = json.loads(told.out)
    (remark,) = document["remarks"]
    assert not document["is_whole"]
    assert told.err == f"mbtool: {remark}\n"


def test_two_captures_of_one_line_have_no_time_between_them(mbtool: CommandLine) -> None:
    document = json.loads(mbtool("stats", LINE, RETRY, "--json").out)
    (link,) = document["links"]
    assert link["transactions"] == 15
    assert link["watched_s"] == pytest.approx(0.594 + 0.341, abs=0.002)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ((LINE, "rtu:/dev/absent@9600-8E1"), "name files or links, not both"),
        ((LINE, "--duration", "1"), "--duration and --allow go with a link"),
        (("rtu:/dev/absent@9600-8E1", "--raw"), "--raw and --link go with files"),
        (("tcp:127.0.0.1:1",), "cannot be listened to"),
        ((LINE, "--where", "unit = 5"), "is not an expression"),
        ((LINE, "--top", "0"), "--top"),
    ],
)
def test_wrong_usage_is_one_line(
    mbtool: CommandLine, arguments: tuple[object, ...], said: str
) -> None:
    told = mbtool("stats", *arguments)
    assert (told.code, told.out) == (exit_codes.USAGE, "")
    assert said in told.err
    assert told.err.count("\n") == 1


def test_a_link_that_cannot_be_opened_is_one_line(mbtool: CommandLine, tmp_path: Path) -> None:
    told = mbtool("stats", f"rtu:{tmp_path / 'absent'}@9600-8E1")
    assert told.code == exit_codes.UNREADABLE
    assert told.err.count("\n") == 1


def test_a_link_on_which_nothing_comes_is_told(mbtool: CommandLine) -> None:
    told = mbtool("stats", "tap:127.0.0.1:0=127.0.0.1:9", "--duration", "0")
    assert (told.code, told.out) == (exit_codes.DONE, "")
    assert told.err.endswith("; Ctrl-C ends\nno transactions\n")


def test_a_filter_makes_no_trouble_of_the_events_of_others(mbtool: CommandLine) -> None:
    damaged = FOLDER / "findings" / "RTU-201.pcap"
    blamed = "! if0 has 1 frame with a wrong CRC that no unit can be blamed for"
    assert blamed in mbtool("stats", damaged, "--where", "unit > 0").out
    assert blamed not in mbtool("stats", damaged, "--where", "number == 1").out


def test_the_name_of_a_rotated_log_stands_for_its_parts(
    mbtool: CommandLine, tmp_path: Path
) -> None:
    for number in (1, 2):
        (tmp_path / f"week-{number:04}.mcap").write_bytes(LINE.read_bytes())
    parts = mbtool("stats", "--json", *sorted(tmp_path.glob("week-*.mcap")))
    whole = mbtool("stats", "--json", tmp_path / "week.mcap")
    assert whole.code == parts.code == exit_codes.DONE
    drop = ("sources",)
    one, other = (json.loads(each.out) for each in (whole, parts))
    assert {key: one[key] for key in one if key not in drop} == {
        key: other[key] for key in other if key not in drop
    }
