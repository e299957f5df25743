"""Holds the figures of stats against those that plain Python computes from decode's jsonl."""

from __future__ import annotations

import json
from collections import Counter, defaultdict
from math import ceil
from typing import TYPE_CHECKING, Any

import pytest

from mbtool.cli.main import run

if TYPE_CHECKING:
    from pathlib import Path

CAPTURES = (
    "cisagov__icsnpp-modbus/testing__traces__modbus_example.pcap",
    "ntop__nDPI/modbus.pcap",
    "nopnoplabs__nopnoplabs.github.io/hist_50fa3d41__pcap__modbus.pcap",
    "zeek__zeek/modbusSmall.pcap",
    "zeek__zeek/fuzz-72.pcap",
    "digitalbond__Quickdraw-Snort/modbus_test_data_part1.pcap",
    "digitalbond__Quickdraw-Snort/modbus_test_data_part2.pcap",
    "kb221svs__modbus-anomaly-detection/modbus.pcap",
    "antoine-lemay__Modbus_dataset/CnC_uploading_exe_modbus_6RTU_with_operate.pcap",
    "apache__plc4x/modbus__tcp__manual-test-capture.pcapng",
    "ITI__ICS-Security-Tools/Modbus__modbus_test.pcap",
    "ITI__ICS-Security-Tools/mb2.pcap",
    "OISF__suricata-verify/tests__modbus__modbus.pcap",
    "uenouan__otsec/pcap__modbus.pcapng",
)

Row = dict[str, Any]
OUTCOMES = (
    "ok", "exception", "no-answer", "not-captured", "unsolicited", "broadcast", "malformed",
)  # fmt: skip
EXACT = 1e-9


@pytest.fixture
def both(tmp_path: Path) -> Any:
    """Give the rows that decode prints of a file, and the document that stats prints."""

    def read(path: Path, capsys: pytest.CaptureFixture[str], *more: str) -> tuple[list[Row], Row]:
        rows = tmp_path / "rows.jsonl"
        run(["decode", str(path), "-o", str(rows), *more])
        capsys.readouterr()
        run(["stats", str(path), "--json", *more])
        return [json.loads(line) for line in rows.read_text().splitlines()], json.loads(
            capsys.readouterr().out
        )

    return read


@pytest.mark.public_captures
@pytest.mark.parametrize("name", CAPTURES)
def test_the_figures_are_those_of_an_independent_calculation(
    name: str, both: Any, public_captures: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rows, document = both(public_captures / name, capsys)
    assert document["transactions"] == len(rows) > 0
    by_link = grouped(rows, lambda row: row["link"])
    assert {link["link"] for link in document["links"]} == set(by_link)
    for link in document["links"]:
        demand_link(link, by_link[link["link"]])


@pytest.mark.public_captures
def test_a_filter_chooses_what_is_counted(
    both: Any, public_captures: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = public_captures / CAPTURES[10]
    rows, document = both(path, capsys, "--where", "unit == 3 and function == 4")
    assert {row["unit"] for row in rows} == {3}
    (link,) = document["links"]
    demand_link(link, rows)


def demand_link(link: Row, rows: list[Row]) -> None:
    begins: list[int] = [row.get("request_ns") or row["response_ns"] for row in rows]
    ends: list[int] = [row.get("response_ns") or 0 for row in rows]
    seconds = (max(*begins, *ends) - min(begins)) / 1e9
    assert link["watched_s"] == pytest.approx(seconds, rel=EXACT)
    demand_tally(link, rows, seconds)
    functions = grouped(rows, lambda row: (row["unit"], row["function"]))
    assert [(one["unit"], one["function"]) for one in link["functions"]] == sorted(functions)
    for one in link["functions"]:
        demand_tally(one, functions[one["unit"], one["function"]], seconds)
    polls = grouped([row for row in rows if "request_ns" in row], key_of_row)
    assert Counter(map(key_of_poll, link["polls"])) == Counter(list(polls))
    periods = periods_of(rows)
    for poll in link["polls"]:
        demand_tally(poll, polls[key_of_poll(poll)], seconds)
        demand_period(poll["period"], periods[key_of_poll(poll)])
    hours = Counter(row["request_ns"] // 3_600_000_000_000 for row in rows if "request_ns" in row)
    assert [hour["requests"] for hour in link["hours"]] == [hours[hour] for hour in sorted(hours)]
    missing = sum(row["outcome"] == "no-answer" for row in rows)
    assert sum(hour["no_answer"] for hour in link["hours"]) == missing


def demand_tally(figures: Row, rows: list[Row], seconds: float) -> None:
    outcomes = Counter(row["outcome"] for row in rows)
    assert {one: figures[one.replace("-", "_")] for one in OUTCOMES} == {
        one: outcomes[one] for one in OUTCOMES
    }
    assert figures["transactions"] == len(rows)
    requests = sum("request_ns" in row for row in rows)
    assert figures["requests"] == requests
    rate = requests / seconds if seconds else None
    assert figures["rate_per_s"] == (rate if rate is None else pytest.approx(rate))
    assert {one["code"]: one["count"] for one in figures["exceptions"]} == Counter(
        row["exception"] for row in rows if row["outcome"] == "exception"
    )
    assert figures["unsolicited_exceptions"] == sum(
        row["outcome"] == "unsolicited" and "exception" in row for row in rows
    )
    assert figures["retries"] == sum(row["retries"] > 0 for row in rows)
    for side in ("request", "response"):
        assert figures[f"{side}_bytes"] == sum(len(row.get(f"{side}_raw", "")) // 2 for row in rows)
    demand_latency(figures["latency"], [row["latency_ns"] for row in rows if "latency_ns" in row])


def demand_latency(figures: Row | None, latencies: list[int]) -> None:
    if figures is None:
        assert latencies == []
        return
    demand_distribution(figures, latencies, (50, 95, 99))
    assert sum(step["count"] for step in figures["histogram"]) == len(latencies)
    if figures["percentile_error"] == 0:
        for step in figures["histogram"]:
            low, high = round(step["from_ms"] * 1e6), round(step["below_ms"] * 1e6)
            assert step["count"] == sum(low <= one < high for one in latencies)


def demand_period(figures: Row | None, periods: list[int]) -> None:
    if figures is None:
        assert periods == []
        return
    demand_distribution(figures, periods, (5, 50, 95))
    ordered = sorted(periods)
    jitter = (nearest_rank(ordered, 95) - nearest_rank(ordered, 5)) / 2 / 1e6
    slack = figures["percentile_error"] * ordered[-1] / 1e6 + 1e-6
    assert figures["jitter_ms"] == pytest.approx(jitter, abs=slack)


def demand_distribution(figures: Row, durations: list[int], percents: tuple[int, ...]) -> None:
    ordered = sorted(durations)
    assert figures["count"] == len(durations)
    assert figures["min_ms"] == ordered[0] / 1e6
    assert figures["max_ms"] == ordered[-1] / 1e6
    assert figures["mean_ms"] == pytest.approx(sum(durations) / len(durations) / 1e6)
    assert figures["percentile_error"] <= 0.02
    for percent in percents:
        right = nearest_rank(ordered, percent) / 1e6
        error = max(figures["percentile_error"], EXACT)
        assert figures[f"p{percent}_ms"] == pytest.approx(right, rel=error)


def nearest_rank(ordered: list[int], percent: int) -> int:
    return ordered[ceil(percent * len(ordered) / 100) - 1]


def periods_of(rows: list[Row]) -> dict[Any, list[int]]:
    """The times between the requests of each poll; a retry is none of its own.

    A retry repeats a request without answer, but not about the usual period after the last poll or
    after that request.
    """
    periods: dict[Any, list[int]] = defaultdict(list)
    for asked in grouped([row for row in rows if "request_ns" in row], master_of).values():
        last: dict[Any, int] = {}
        before: Row | None = None
        for row in sorted(asked, key=lambda one: one["request_ns"]):
            key, at_ns = key_of_row(row), row["request_ns"]
            repeats = before is not None and before["outcome"] == "no-answer"
            if repeats and before is not None and key_of_row(before) == key:
                distances = [at_ns - last[key], at_ns - before["request_ns"]]
                is_poll = any(is_usual(one, periods[key]) for one in distances)
            else:
                is_poll = True
            if is_poll:
                if key in last:
                    periods[key].append(at_ns - last[key])
                last[key] = at_ns
            before = row
    return periods


def is_usual(distance_ns: int, periods: list[int]) -> bool:
    """True if it differs from the median of at least five periods by a quarter at most."""
    if len(periods) < 5:
        return False
    median = nearest_rank(sorted(periods), 50)
    return abs(distance_ns - median) <= median / 4


def grouped(rows: list[Row], key: Any) -> dict[Any, list[Row]]:
    groups: dict[Any, list[Row]] = defaultdict(list)
    for row in rows:
        groups[key(row)].append(row)
    return groups


FIELDS = (
    "unit", "function", "sub_function", "address", "quantity", "write_address", "write_quantity",
)  # fmt: skip


def master_of(row: Row) -> str | None:
    source = row.get("source")
    return None if source is None else source.rpartition(":")[0].strip("[]")


def key_of_row(row: Row) -> tuple[Any, ...]:
    return (master_of(row), *(row.get(field) for field in FIELDS))


def key_of_poll(poll: Row) -> tuple[Any, ...]:
    return (poll["master"], *(poll[field] for field in FIELDS))
