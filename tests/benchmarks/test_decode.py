from __future__ import annotations

from tests.benchmarks.decode import measure, report


def test_every_stage_gives_all_transactions() -> None:
    given = {one.stage: one.gives for one in measure(50, rounds=1)}
    packets_of_a_handshake_and_a_goodbye, heading_and_day = 6, 2
    assert given == {
        "read": 100 + packets_of_a_handshake_and_a_goodbye,
        "reassemble": 100,
        "decode": 50,
        "name": 50,
        "jsonl": 50,
        "table": 50 + heading_and_day,
    }


def test_the_report_has_a_line_for_each_stage() -> None:
    lines = report(measure(10, rounds=1)).splitlines()
    assert [line.split()[0] for line in lines] == [
        "stage",
        "read",
        "reassemble",
        "decode",
        "name",
        "jsonl",
        "table",
        "file",
    ]


def test_time_grows_no_faster_than_the_capture() -> None:
    few, many = measure(300, rounds=3), measure(3000, rounds=3)
    for one, ten in zip(few, many, strict=True):
        assert ten.seconds < 4 * 10 * one.seconds, one.stage
