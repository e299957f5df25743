from __future__ import annotations

import json
import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import msgspec
import pytest
from mcap.reader import make_reader

import mbtool
from mbtool.core import Chunk, UsageError, WireEvent
from mbtool.logs import writer
from mbtool.logs.reader import LogReader, read_log
from mbtool.logs.writer import FLUSH_AFTER_NS, LogWriter
from tests.logs.samples import (
    EVENT,
    NAMED,
    ONE_OF_EACH,
    START_NS,
    chunk,
    stock_messages,
    transaction,
    write_log,
)

SECOND_NS = 1_000_000_000


def test_each_kind_of_item_has_its_topic(tmp_path: Path) -> None:
    messages = stock_messages(write_log(tmp_path / "x.mcap", ONE_OF_EACH))
    assert {(topic, schema) for topic, schema, _ in messages} == {
        ("/rs485/evidence", "mbtool.Evidence"),
        ("/rs485/transactions", "mbtool.Transaction"),
        ("/10.0.0.9/events", "mbtool.WireEvent"),
        ("/10.0.0.9/chunks", "mbtool.Chunk"),
        ("/eth0/chunks", "mbtool.Chunk"),
        ("/points", "mbtool.PointValue"),
        ("/findings", "foxglove.Log"),
    }


def test_a_log_tells_who_made_it(tmp_path: Path) -> None:
    path = write_log(tmp_path / "x.mcap", [])
    with path.open("rb") as stream:
        reader = make_reader(stream)
        header = reader.get_header()
        metadata = {record.name: record.metadata for record in reader.iter_metadata()}
        (attachment,) = reader.iter_attachments()
    assert (header.profile, header.library) == ("mbtool", f"mbtool {mbtool.__version__}")
    assert metadata == {
        "mbtool.capture": {"log_format": "2", "version": mbtool.__version__, "host": "bench"},
        "mbtool.link": {"name": "rs485", "spec": "rtu:/dev/ttyUSB0@19200-8E1"},
    }
    assert attachment.name == "idec-ft1a-touch"
    assert attachment.media_type == "application/json"
    assert json.loads(attachment.data) == {"name": "idec-ft1a-touch"}


def test_a_transaction_stands_after_its_evidence_in_the_order_of_time_too(tmp_path: Path) -> None:
    read = transaction()
    assert read.response_ns is not None
    path = write_log(tmp_path / "x.mcap", [chunk(), read])
    with path.open("rb") as stream:
        times = [message.log_time for _, _, message in make_reader(stream).iter_messages()]
    assert times == [START_NS, read.response_ns]


@pytest.mark.parametrize(("code", "level"), [("FT1A-A3", 4), ("MB-204", 3), ("MB-404", 2)])
def test_a_finding_has_the_level_of_its_rule(code: str, level: int, tmp_path: Path) -> None:
    named = msgspec.structs.replace(NAMED, findings=[code])
    messages = stock_messages(write_log(tmp_path / "x.mcap", [named]))
    (finding,) = (json.loads(data) for topic, _, data in messages if topic == "/findings")
    assert (finding["name"], finding["level"]) == (code, level)


def test_a_finding_reads_in_the_log_panel(tmp_path: Path) -> None:
    messages = stock_messages(write_log(tmp_path / "x.mcap", [NAMED]))
    (finding,) = (json.loads(data) for topic, _, data in messages if topic == "/findings")
    assert finding.pop("message").startswith("FT1A-Q3 ")
    assert finding == {
        "timestamp": {"sec": 1_700_000_000, "nsec": 5_500_000},
        "level": 4,
        "name": "FT1A-Q3",
        "file": "rs485",
        "line": 1,
    }


def test_the_log_is_complete_as_soon_as_it_is_created(tmp_path: Path) -> None:
    log = LogWriter(tmp_path / "x.mcap", capture={"host": "bench"})
    with LogReader.open(tmp_path / "x.mcap") as reader:
        assert reader.capture["host"] == "bench"
        assert list(reader.items()) == []
        assert not reader.closed
    log.close()


def test_an_open_log_has_topics_and_schemas_for_the_stock_reader(tmp_path: Path) -> None:
    log = LogWriter(tmp_path / "x.mcap", capture={})
    log.write(chunk())
    log.write(transaction())
    log.tick(START_NS)
    assert [(topic, schema) for topic, schema, _ in stock_messages(tmp_path / "x.mcap")] == [
        ("/rs485/evidence", "mbtool.Evidence"),
        ("/rs485/transactions", "mbtool.Transaction"),
    ]
    log.close()


def test_nothing_stays_in_memory_longer_than_the_limit(tmp_path: Path) -> None:
    path = tmp_path / "x.mcap"
    log = LogWriter(path, capture={})
    log.tick(START_NS)
    log.write(chunk(1))
    log.tick(START_NS + FLUSH_AFTER_NS - 1)
    assert list(read_log(path)) == []
    log.tick(START_NS + FLUSH_AFTER_NS)
    assert list(read_log(path)) == [chunk(1)]
    # What comes after a pause is not written at once, so a slow line makes no more chunks.
    log.tick(START_NS + 10 * SECOND_NS)
    log.write(chunk(2))
    log.tick(START_NS + 10 * SECOND_NS + 1)
    assert list(read_log(path)) == [chunk(1)]
    log.close()
    assert list(read_log(path)) == [chunk(1), chunk(2)]


def test_a_clock_that_goes_back_flushes(tmp_path: Path) -> None:
    log = LogWriter(tmp_path / "x.mcap", capture={})
    log.tick(START_NS)
    log.write(chunk())
    log.tick(START_NS - SECOND_NS)
    assert list(read_log(tmp_path / "x.mcap")) == [chunk()]
    log.close()


def test_metadata_of_the_end_is_added_at_the_end(tmp_path: Path) -> None:
    log = LogWriter(tmp_path / "x.mcap", capture={"host": "bench"})
    log.write(chunk())
    log.close({"dropped": "3"})
    log.close({"dropped": "4"})
    with LogReader.open(tmp_path / "x.mcap") as reader:
        assert "dropped" not in reader.capture
        assert list(reader.items()) == [chunk()]
        assert reader.capture["dropped"] == "3"
        assert reader.capture["host"] == "bench"
        assert reader.closed


def test_two_writers_cannot_share_a_file(tmp_path: Path) -> None:
    path = tmp_path / "x.mcap"
    first = LogWriter(path, capture={})
    with pytest.raises(UsageError, match=r"x\.mcap: the file exists"):
        LogWriter(path, capture={})
    first.write(chunk())
    first.close()
    assert list(read_log(path)) == [chunk()]


def test_a_command_line_that_is_no_text_can_be_recorded(tmp_path: Path) -> None:
    command = os.fsdecode(b"sniff -w \xff.mcap")
    with LogWriter(tmp_path / "x.mcap", capture={"command": command}) as log:
        log.add_profile(os.fsdecode(b"\xffpump"), b"{}")
        log.add_device("all", "pump")
    with LogReader.open(tmp_path / "x.mcap") as reader:
        assert reader.capture["command"] == "sniff -w ?.mcap"
        assert reader.profiles == {"?pump": b"{}"}
        assert reader.devices == {"all": "pump"}


def test_a_link_with_a_slash_does_not_make_a_topic_of_two_levels(tmp_path: Path) -> None:
    item = WireEvent(ts_ns=1, link="a/b", kind=EVENT.kind, message="")
    path = write_log(tmp_path / "x.mcap", [item])
    assert [topic for topic, _, _ in stock_messages(path)] == ["/a_b/events"]
    assert list(read_log(path)) == [item]


def test_the_number_of_topics_is_bounded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(writer, "MAX_LINKS", 2)
    items = [
        WireEvent(ts_ns=1, link=str(number % 5), kind=EVENT.kind, message="")
        for number in range(10)
    ]
    path = write_log(tmp_path / "x.mcap", items)
    topics = {topic for topic, _, _ in stock_messages(path)}
    assert topics == {"/0/events", "/1/events", "/others/events"}
    assert list(read_log(path)) == items


@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="needs SIGKILL")
@pytest.mark.parametrize("pause_s", [0.002, 0.05])
def test_a_killed_recorder_loses_at_most_its_last_second(tmp_path: Path, pause_s: float) -> None:
    path = tmp_path / "x.mcap"
    program = [sys.executable, "-m", "tests.logs.killed_writer", str(path), str(pause_s)]
    root = Path(__file__).parents[2]
    with subprocess.Popen(program, stdout=subprocess.PIPE, cwd=root, text=True) as child:
        assert child.stdout is not None
        said = [tuple(map(int, child.stdout.readline().split()))]
        life_ns = random.randrange(1_300_000_000, 2_000_000_000)
        while said[-1][1] - said[0][1] < life_ns:
            said.append(tuple(map(int, child.stdout.readline().split())))
        child.kill()
        killed_ns = time.monotonic_ns()
        said += [tuple(map(int, line.split())) for line in child.stdout if line.endswith("\n")]
    due = [number for number, written_ns in said if written_ns < killed_ns - SECOND_NS]
    assert due
    topics = [topic for topic, _, _ in stock_messages(path)]
    found = list(read_log(path))
    reads = [item for item in found if isinstance(item, Chunk)]
    decoded = [item for item in found if not isinstance(item, Chunk)]
    assert reads == [chunk(number) for number in range(len(reads))]
    assert decoded == [transaction(number) for number in range(len(decoded))]
    assert topics.count("/rs485/transactions") == len(decoded)
    assert min(len(reads), len(decoded)) >= len(due)


@pytest.mark.skipif(sys.platform == "win32", reason="needs a limit of the system")
@pytest.mark.parametrize("room", [0, 100, 500])
def test_a_disk_that_is_full_from_the_start_leaves_no_file_and_says_so(
    tmp_path: Path, room: int
) -> None:
    path = tmp_path / "a.mcap"
    code = (
        "import resource, sys\n"
        "from mbtool.core import OutputError\n"
        "from mbtool.logs import LogWriter\n"
        f"resource.setrlimit(resource.RLIMIT_FSIZE, ({room}, {room}))\n"
        "try:\n"
        f"    LogWriter({str(path)!r}, capture={{'command': 'x' * 1000}})\n"
        "except OutputError as error:\n"
        "    print(error)\n"
    )
    ran = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120)
    assert ran.stdout == f"{path}: the log cannot be begun: File too large\n", ran.stderr
    assert not path.exists()
