"""What several transactions show is in the log of sniff, as check finds it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from mbtool.core import SerialFormat, SerialLink
from mbtool.decode.line_timing import LineTiming
from mbtool.logs import LogWriter, RotatingLog, Rotation, read_log
from mbtool.troubles.words import WORDS
from mbtool.workflows.check import CheckRun
from mbtool.workflows.shared.checked_log import begin_checked
from mbtool.workflows.shared.reading import Reading, ReadingOptions
from tests.logs.samples import stock_messages

if TYPE_CHECKING:
    from collections.abc import Callable

CAPTURES = Path(__file__).resolve().parents[3] / "captures"
LINE = SerialFormat.parse("19200-8E1")


def logged(capture: Path, begin: Callable[[], LogWriter | RotatingLog]) -> None:
    """Log the records of a capture, as sniff does."""
    reading = Reading([str(capture)], ReadingOptions())
    records = list(reading.records())
    lines = {
        one.link: SerialLink(one.link, LINE)
        for one in records
        if reading.format_of(one.link) is not None
    }
    log = begin_checked(begin, LineTiming(), lines, None)
    for record in records:
        log.write(record)
    log.close({"discarded_packets": "0"})


def findings(log: Path) -> list[tuple[int, str, str]]:
    told = [json.loads(data) for topic, _, data in stock_messages(log) if topic == "/findings"]
    return sorted(
        (one["timestamp"]["sec"] * 10**9 + one["timestamp"]["nsec"], one["name"], one["file"])
        for one in told
    )


@pytest.mark.parametrize(
    "name",
    [
        "findings/SEC-201.pcap",
        "findings/SEC-101.pcap",
        "findings/TCP-202.pcap",
        "findings/MB-402.pcap",
        "findings/RTU-101.pcap",
        "findings/RTU-104.pcap",
        "findings/MB-301.pcap",
        "plant.pcap",
    ],
)
def test_the_log_has_the_findings_of_check(name: str, tmp_path: Path) -> None:
    log = tmp_path / "x.mcap"
    logged(CAPTURES / name, lambda: LogWriter(log, capture={}))
    run = CheckRun([str(CAPTURES / name)], ReadingOptions())
    found = [one.finding for one in run.findings()]
    assert found
    rules = [one for one in findings(log) if one[1] not in WORDS]
    assert rules == sorted((one.ts_ns, one.code, one.link) for one in found)
    troubles = [one for one in run.judgement().troubles if one.code in WORDS]
    logged_codes = sorted(code for _, code, _ in findings(log) if code in WORDS)
    assert logged_codes == sorted(one.code for one in troubles)


def test_a_finding_about_one_transaction_is_logged_once(tmp_path: Path) -> None:
    log = tmp_path / "x.mcap"
    logged(CAPTURES / "findings" / "MB-103.pcap", lambda: LogWriter(log, capture={}))
    assert [code for _, code, _ in findings(log)] == ["UNIT-REFUSES", "MB-103"]


def test_a_finding_names_its_place_and_how_often_it_was_seen(tmp_path: Path) -> None:
    log = tmp_path / "x.mcap"
    logged(CAPTURES / "findings" / "SEC-201.pcap", lambda: LogWriter(log, capture={}))
    (told,) = [json.loads(data) for topic, _, data in stock_messages(log) if topic == "/findings"]
    assert told["message"].startswith("SEC-201 10.0.0.101: 10.0.0.9 asks 10 addresses")
    assert told["message"].endswith("(10 times)")
    assert (told["level"], told["line"]) == (3, 0)


def test_what_is_read_again_is_as_without_the_findings(tmp_path: Path) -> None:
    plain, checked = tmp_path / "plain.mcap", tmp_path / "checked.mcap"
    capture = CAPTURES / "findings" / "SEC-201.pcap"
    logged(capture, lambda: LogWriter(checked, capture={}))
    with LogWriter(plain, capture={}) as log:
        for record in Reading([str(capture)], ReadingOptions()).records():
            log.write(record)
    assert list(read_log(checked)) == list(read_log(plain))


def test_a_rotated_log_gets_the_findings_too(tmp_path: Path) -> None:
    path = tmp_path / "x.mcap"
    logged(
        CAPTURES / "findings" / "SEC-201.pcap", lambda: RotatingLog(path, Rotation(), capture={})
    )
    assert [code for _, code, _ in findings(tmp_path / "x-0001.mcap")] == ["SEC-201"]
