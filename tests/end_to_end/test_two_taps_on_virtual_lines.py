"""Two taps on one line, from the ports to the log and back."""

from __future__ import annotations

import os
import sys
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

import pytest

from mbtool.core import Direction, LinkError, Quiet, SerialLink, parse_link
from mbtool.decode.decoder import Decoder
from mbtool.devices import Assignments, NamedTransaction, Namer
from mbtool.logs import LogReader
from mbtool.logs.links import SPEC
from mbtool.logs.opening import create_log
from mbtool.modbus import rtu_adu
from mbtool.workflows.shared.reading import Reading, ReadingOptions
from mbtool.workflows.sniff import Sniffer, serial_lines
from tests.records import without_origins
from tests.workflows.bench import FAST, Bench, speak, until
from tests.workflows.evidence import LINE, MS, READ, START_NS, VALUES, WRITE, exchange

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from mbtool.decode.decoder import Evidence, Record

pytestmark = pytest.mark.skipif(
    sys.platform == "win32", reason="pseudo-terminals need Linux or macOS"
)


REQUEST, RESPONSE = Direction.REQUEST, Direction.RESPONSE


@pytest.fixture
def wires(tmp_path: Path) -> Iterator[tuple[SerialLink, int, int]]:
    """The link that hears both wires, and where the master and a slave speak."""
    with Bench() as bench:
        ends = []
        for side in ("master", "slave"):
            folder = tmp_path / side
            folder.mkdir()
            ends.append(bench.line(folder))
        (master, asking), (slave, answering) = ends
        yield SerialLink(master.port, FAST, slave_port=slave.port), asking, answering


def _sniffer(link: SerialLink, log: Path) -> Sniffer:
    decoder = Decoder(Namer(), lines=serial_lines([link]))
    return Sniffer([link], decoder, begin_log=partial(create_log, str(log), [link], Assignments()))


def _transactions(records: list[Record]) -> list[NamedTransaction]:
    return [record for record in records if isinstance(record, NamedTransaction)]


def test_both_sides_are_heard_logged_and_decoded_again(
    wires: tuple[SerialLink, int, int], tmp_path: Path
) -> None:
    link, asking, answering = wires
    path = tmp_path / "a.mcap"
    records: list[Record] = []
    with _sniffer(link, path) as sniffer:
        # An echo: on one wire nobody could tell the two apart.
        for descriptor, pdu in ((asking, WRITE), (answering, WRITE), (asking, READ)):
            speak(descriptor, pdu)
        speak(answering, VALUES)
        stop = until(records, lambda found: len(_transactions(found)) >= 2)
        for record in sniffer.records(stop):
            records.append(record)
    outcomes = [(one.outcome, one.direction_by, one.confidence) for one in _transactions(records)]
    assert outcomes == [("ok", "port", 1.0)] * 2
    logged = list(Reading([str(path)], ReadingOptions()).records())
    assert without_origins(logged) == records
    assert list(Reading([str(path)], ReadingOptions(raw=True)).records()) == logged
    with LogReader.open(path) as log:
        assert parse_link(log.links["tap+tap"][SPEC]) == link


@pytest.mark.parametrize("lost", [0, 1])
def test_a_side_that_goes_away_ends_the_link_with_a_clear_message(
    tmp_path: Path, lost: int
) -> None:
    path = tmp_path / "a.mcap"
    folders = [tmp_path / "master", tmp_path / "slave"]
    for folder in folders:
        folder.mkdir()
    with Bench() as one, Bench() as other:
        benches = [one, other]
        (master, _), (slave, _) = (
            bench.line(folder) for bench, folder in zip(benches, folders, strict=True)
        )
        link = SerialLink(master.port, FAST, slave_port=slave.port)

        def sniff() -> None:
            with _sniffer(link, path) as sniffer:
                benches[lost].close()
                for _ in sniffer.records(until([], lambda _: False)):
                    pass

        with pytest.raises(LinkError) as caught:
            sniff()
    assert str(caught.value).startswith(f"link {link} needs both its ports: serial port ")
    assert str(folders[lost]) in str(caught.value).partition(": ")[2]
    with LogReader.open(path) as log:
        list(log.items())
        assert log.closed


def test_a_response_that_is_read_first_is_no_riddle(
    wires: tuple[SerialLink, int, int], tmp_path: Path
) -> None:
    link, asking, answering = wires
    with _sniffer(link, tmp_path / "a.mcap") as sniffer:
        # The slave's adapter is quicker than the master's by the time that this takes.
        os.write(answering, rtu_adu(1, VALUES))
        os.write(asking, rtu_adu(1, READ))
        records: list[Record] = []
        for record in sniffer.records(until(records, lambda found: bool(_transactions(found)))):
            records.append(record)
    assert [one.outcome for one in _transactions(records)] == ["ok"]


def test_bytes_that_say_who_speaks_need_no_guess() -> None:
    request, response = exchange(0, WRITE, WRITE)
    two: list[Evidence] = [
        replace(response, direction=RESPONSE),
        replace(request, direction=REQUEST),
    ]
    silence = Quiet(START_NS + 7_000 * MS, LINE.name)
    for evidence in (two, [*two, silence]):  # In the order in which they happened to be read.
        decoder = Decoder(Namer(), lines={LINE.name: LINE})
        records = [record for one in evidence for record in decoder.feed(one)]
        (record,) = _transactions([*records, *decoder.close()])
        assert (record.outcome, record.direction_by, record.confidence) == ("ok", "port", 1.0)
