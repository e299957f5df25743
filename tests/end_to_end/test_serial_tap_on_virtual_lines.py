"""A tap in a cut serial line, from the stations on either side to the log and back."""

from __future__ import annotations

import sys
from functools import partial
from threading import Thread
from typing import TYPE_CHECKING

import pytest

from mbtool.core import SerialLink, parse_link
from mbtool.decode.decoder import Decoder
from mbtool.devices import Assignments, NamedTransaction, Namer
from mbtool.logs import LogReader
from mbtool.logs.links import SPEC
from mbtool.logs.opening import create_log
from mbtool.modbus import rtu_adu
from mbtool.workflows.shared.reading import Reading, ReadingOptions
from mbtool.workflows.sniff import Sniffer, serial_lines
from tests.records import without_origins
from tests.sources.live_helpers import read_exactly
from tests.workflows.bench import FAST, Bench, speak, until
from tests.workflows.evidence import READ, VALUES, WRITE

if TYPE_CHECKING:
    from pathlib import Path

    from mbtool.decode.decoder import Record

pytestmark = pytest.mark.skipif(
    sys.platform == "win32", reason="pseudo-terminals need Linux or macOS"
)

EXCHANGES = ((WRITE, WRITE), (READ, VALUES))  # The first would be a riddle on one wire.


def _answer(station: int) -> None:
    for request, response in EXCHANGES:
        assert read_exactly(station, len(rtu_adu(1, request))) == rtu_adu(1, request)
        speak(station, response)


def _ask(station: int, heard: list[bytes]) -> None:
    for request, response in EXCHANGES:
        speak(station, request)
        heard.append(read_exactly(station, len(rtu_adu(1, response))))


def test_master_and_slave_talk_through_the_tap_which_logs_both(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    folders = [tmp_path / "master", tmp_path / "slave"]
    for folder in folders:
        folder.mkdir()
    records: list[Record] = []
    heard: list[bytes] = []
    with Bench() as bench:
        (one, master), (other, slave) = (bench.line(folder) for folder in folders)
        link = SerialLink(one.port, FAST, slave_port=other.port, is_relay=True)
        decoder = Decoder(Namer(), lines=serial_lines([link]))
        begin = partial(create_log, str(path), [link], Assignments())
        with Sniffer([link], decoder, begin_log=begin) as sniffer:
            stations = [
                Thread(target=_answer, args=(slave,)),
                Thread(target=_ask, args=(master, heard)),
            ]
            for station in stations:
                station.start()
            for record in sniffer.records(until(records, lambda found: len(found) >= 2)):
                records.append(record)
            for station in stations:
                station.join()
    assert heard == [rtu_adu(1, response) for _, response in EXCHANGES]
    transactions = [record for record in records if isinstance(record, NamedTransaction)]
    assert [(one.outcome, one.direction_by) for one in transactions] == [("ok", "port")] * 2
    logged = list(Reading([str(path)], ReadingOptions()).records())
    assert without_origins(logged) == records
    assert list(Reading([str(path)], ReadingOptions(raw=True)).records()) == logged
    with LogReader.open(path) as log:
        assert parse_link(log.links[link.name][SPEC]) == link
