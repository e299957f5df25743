"""Recordings made ready to be played."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from mbtool.core import CutError, DamageError, InputError, UsageError, parse_line, parse_link
from mbtool.modbus import mbap_adu
from mbtool.replay import OnMiss
from mbtool.slave import TcpSlave
from mbtool.workflows.asking import TcpMaster
from mbtool.workflows.reading import ReadingOptions
from mbtool.workflows.replaying import read_recording, recorded_slave
from mbtool.workflows.where import parse_where
from tests.packets.building import MASTER, End, Talk, pcap
from tests.workflows.evidence import (
    READ,
    VALUES,
    WRITE,
    capture_file,
    captured,
    damaged_log,
    exchange,
)

if TYPE_CHECKING:
    from pathlib import Path

    from mbtool.replay import Recording


def _on_two_slaves() -> bytes:
    """Unit 1 at two addresses, and unit 2 at one of them."""
    packets = []
    for number, host in enumerate(("10.0.0.2", "10.0.0.3")):
        talk = Talk(End(MASTER, 49152 + number, 1000), End(host, 502, 5000))
        packets += talk.handshake()
        packets += [talk.request(mbap_adu(1, 1, WRITE)), talk.response(mbap_adu(1, 1, WRITE))]
    packets += [talk.request(mbap_adu(2, 2, READ)), talk.response(mbap_adu(2, 2, VALUES))]
    return pcap(packets)


def _recording(path: Path, where: str = "unit >= 0") -> tuple[Recording, list[InputError]]:
    cuts: list[InputError] = []
    return read_recording(str(path), ReadingOptions(), parse_where(where), cuts.append), cuts


def test_a_recording_answers_as_its_slave_did(tmp_path: Path) -> None:
    path = tmp_path / "a.pcap"
    path.write_bytes(capture_file(2))
    recording, cuts = _recording(path)
    assert cuts == []
    shell = recorded_slave(
        recording,
        parse_link("tcp:127.0.0.1:0"),
        on_miss=OnMiss.EXCEPTION,
        speed=None,
        allow_remote=False,
    )
    assert isinstance(shell, TcpSlave)
    with shell, TcpMaster(shell.endpoint) as master:
        assert master.ask(1, READ) == VALUES
        assert master.ask(1, READ) == VALUES
        assert master.ask(1, READ) == VALUES


def test_only_what_is_wanted_is_played(tmp_path: Path) -> None:
    path = tmp_path / "a.pcap"
    path.write_bytes(_on_two_slaves())
    recording, _ = _recording(path, "link == '10.0.0.3'")
    assert set(recording.answers) == {(1, WRITE), (2, READ)}


def test_a_unit_on_several_links_is_refused_with_what_would_be_right(tmp_path: Path) -> None:
    path = tmp_path / "a.pcap"
    path.write_bytes(_on_two_slaves())
    with pytest.raises(UsageError) as caught:
        _recording(path)
    assert str(caught.value) == (
        f"{path}: unit 1 is on several links (10.0.0.2, 10.0.0.3); "
        "choose one with --where 'link == \"10.0.0.2\"'"
    )
    recording, _ = _recording(path, "unit == 2 or link == '10.0.0.2'")
    assert set(recording.answers) == {(1, WRITE), (2, READ)}


@pytest.mark.parametrize(("exchanges", "where"), [(0, "unit >= 0"), (2, "unit == 9")])
def test_a_recording_without_a_request_is_refused(
    tmp_path: Path, exchanges: int, where: str
) -> None:
    path = tmp_path / "a.pcap"
    path.write_bytes(capture_file(exchanges))
    with pytest.raises(InputError, match=r"a\.pcap: no request to play an answer for"):
        _recording(path, where)


def test_a_cut_recording_is_played_as_far_as_it_goes(tmp_path: Path) -> None:
    path = tmp_path / "a.pcap"
    path.write_bytes(pcap(captured(2))[:-1])
    recording, cuts = _recording(path)
    assert [type(cut) for cut in cuts] == [CutError]
    assert len(recording.answers[1, READ]) == 2


@pytest.mark.parametrize("number", range(3))
@pytest.mark.parametrize("raw", [False, True])
def test_of_a_damaged_log_what_is_there_is_played(tmp_path: Path, number: int, raw: bool) -> None:
    path = damaged_log(tmp_path / "a.mcap", number)
    told: list[InputError] = []
    recording = read_recording(
        str(path), ReadingOptions(raw=raw), parse_where("unit >= 0"), told.append
    )
    assert len(recording.answers[1, READ]) == 2
    (error,) = told
    assert isinstance(error, DamageError)
    assert "all else was read" in str(error)


def test_a_recording_that_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="absent: there is no such file"):
        _recording(tmp_path / "absent")


def test_a_recording_cannot_be_played_on_an_interface(tmp_path: Path) -> None:
    path = tmp_path / "a.pcap"
    path.write_bytes(capture_file())
    recording, _ = _recording(path)
    with pytest.raises(UsageError, match="a slave needs rtu:PORT"):
        recorded_slave(
            recording,
            parse_link("net:eth0"),
            on_miss=OnMiss.IMAGE,
            speed=1.0,
            allow_remote=False,
        )


def test_the_bytes_of_a_line_are_a_recording_like_any_other(tmp_path: Path) -> None:
    path = tmp_path / "bench.bin"
    path.write_bytes(b"".join(chunk.data for chunk in exchange(0)))
    options = ReadingOptions(line=parse_line("rtu@19200-8E1"))
    recording = read_recording(str(path), options, parse_where("unit >= 0"), lambda _: None)
    assert recording.units == {1}
    ((answer,),) = recording.answers.values()
    assert answer.pdu == VALUES
