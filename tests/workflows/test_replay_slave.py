"""Recordings made ready to be played."""

from __future__ import annotations

import gc
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from mbtool.core import InputError, TcpLink, UsageError, parse_line, parse_link
from mbtool.devices import NamedTransaction
from mbtool.master.links import open_master
from mbtool.modbus import Transport, mbap_adu
from mbtool.modbus.response import wire_pieces
from mbtool.query.where import parse_where
from mbtool.replay import Control, MatchStrategy, OnMiss, TimeRange
from mbtool.slave.shells import TcpSlave
from mbtool.workflows.replay_slave import MAX_LATENCY_NS, PlayedSlave, SlaveOptions, SlaveRun
from mbtool.workflows.shared.reading import ReadingOptions
from tests.packets.building import MASTER, End, Talk, pcap
from tests.sources.live_helpers import MASTER_TIMEOUT_NS
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
    from mbtool.replay import Recording


OURS = Path(__file__).resolve().parents[2] / "captures"
ANYWHERE = parse_link("tcp:127.0.0.1:0")


@pytest.fixture
def capture(tmp_path: Path) -> Path:
    path = tmp_path / "a.pcap"
    path.write_bytes(capture_file(3))
    return path


def _on_two_slaves() -> bytes:
    """Unit 1 at two addresses, and unit 2 at one of them."""
    packets = []
    for number, host in enumerate(("10.0.0.2", "10.0.0.3")):
        talk = Talk(End(MASTER, 49152 + number, 1000), End(host, 502, 5000))
        packets += talk.handshake()
        packets += [talk.request(mbap_adu(1, 1, WRITE)), talk.response(mbap_adu(1, 1, WRITE))]
    packets += [talk.request(mbap_adu(2, 2, READ)), talk.response(mbap_adu(2, 2, VALUES))]
    return pcap(packets)


def _recording(path: Path, where: str = "unit >= 0") -> tuple[Recording, list[str]]:
    told: list[str] = []
    run = SlaveRun(str(path), SlaveOptions(wanted=parse_where(where)), told.append)
    return run.recording, told


def test_a_recording_answers_as_its_slave_did(tmp_path: Path) -> None:
    path = tmp_path / "a.pcap"
    path.write_bytes(capture_file(2))
    run = SlaveRun(str(path), SlaveOptions(on_miss=OnMiss.EXCEPTION, rate=None))
    shell = run.create_slave(ANYWHERE).shell
    assert isinstance(shell, TcpSlave)
    with shell, open_master(TcpLink(shell.endpoint), MASTER_TIMEOUT_NS) as master:
        assert master.ask(1, READ) == VALUES
        assert master.ask(1, READ) == VALUES
        assert master.ask(1, READ) == VALUES


def test_transactions_are_freed_once_the_recording_is_built(tmp_path: Path) -> None:
    path = tmp_path / "a.pcap"
    path.write_bytes(capture_file(50))

    def held() -> int:
        gc.collect()
        return sum(isinstance(one, NamedTransaction) for one in gc.get_objects())

    before = held()
    run = SlaveRun(str(path), SlaveOptions())
    assert len(run.recording.order) == 50
    assert held() == before


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
        "choose one with --where 'link == \"10.0.0.2\"', or, as the slave, give each a link of "
        "its own: --on WHO=LINK, or --on all=tcp:127.0.0.0/24:1502"
    )
    recording, _ = _recording(path, "unit == 2 or link == '10.0.0.2'")
    assert set(recording.answers) == {(1, WRITE), (2, READ)}


@pytest.mark.parametrize(
    ("exchanges", "where", "problem"),
    [
        (0, "unit >= 0", "no request to play an answer for"),
        (2, "unit == 9", r"none of its 2 transactions fits the condition \(where\)"),
    ],
)
def test_a_recording_without_a_request_is_refused(
    tmp_path: Path, exchanges: int, where: str, problem: str
) -> None:
    path = tmp_path / "a.pcap"
    path.write_bytes(capture_file(exchanges))
    with pytest.raises(InputError, match=rf"a\.pcap: {problem}"):
        _recording(path, where)


def test_a_cut_recording_is_played_as_far_as_it_goes(tmp_path: Path) -> None:
    path = tmp_path / "a.pcap"
    path.write_bytes(pcap(captured(2))[:-1])
    recording, told = _recording(path)
    (line,) = told
    assert line.startswith(f"mbtool: {path}: ends in the middle of a record")
    assert line.endswith("; playing what is there")
    assert len(recording.answers[1, READ]) == 2


@pytest.mark.parametrize("number", range(3))
@pytest.mark.parametrize("raw", [False, True])
def test_a_damaged_log_is_played_as_far_as_it_can_be_read(
    tmp_path: Path, number: int, raw: bool
) -> None:
    path = damaged_log(tmp_path / "a.mcap", number)
    told: list[str] = []
    options = SlaveOptions(reading=ReadingOptions(raw=raw))
    recording = SlaveRun(str(path), options, told.append).recording
    assert len(recording.answers[1, READ]) == 2
    (line,) = told
    assert "all else was read" in line


def test_a_recording_that_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="absent: there is no such file"):
        _recording(tmp_path / "absent")


def test_a_recording_cannot_be_played_on_an_interface(tmp_path: Path) -> None:
    path = tmp_path / "a.pcap"
    path.write_bytes(capture_file())
    run = SlaveRun(str(path), SlaveOptions())
    with pytest.raises(UsageError, match="a slave needs rtu:PORT"):
        run.create_slave(parse_link("net:eth0"))


def test_the_bytes_of_a_line_are_a_recording_like_any_other(tmp_path: Path) -> None:
    path = tmp_path / "bench.bin"
    path.write_bytes(b"".join(chunk.data for chunk in exchange(0)))
    options = ReadingOptions(line=parse_line("rtu@19200-8E1"))
    recording = SlaveRun(str(path), SlaveOptions(reading=options)).recording
    assert recording.units == {1}
    ((answer,),) = recording.answers.values()
    assert answer.pdu == VALUES


# How it is played ------------------------------------------------------------------------------


def _slave(path: Path, **options: object) -> PlayedSlave:
    return SlaveRun(str(path), SlaveOptions(**options)).create_slave(ANYWHERE)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("latency", "delays"),
    [
        ("none", {0}),
        ("5ms", {5_000_000}),
        ("750us", {750_000}),
        ("1.5s", {1_500_000_000}),
    ],
)
def test_the_latency_can_be_given(capture: Path, latency: str, delays: set[int]) -> None:
    slave = _slave(capture, latency=latency)
    assert {_delay_ns(slave) for _ in range(3)} == delays


def test_sampled_latencies_are_the_same_in_each_run(capture: Path) -> None:
    runs = [_slave(capture, latency="sampled") for _ in range(2)]
    first, second = ([_delay_ns(slave) for _ in range(9)] for slave in runs)
    recorded = set(SlaveRun(str(capture), SlaveOptions()).recording.latencies(1, 3))
    assert first == second
    assert set(first) <= recorded


@pytest.mark.parametrize("latency", ["5", "ms", "-5ms", "5 ms", "5min", "", "9" * 40 + "s"])
def test_a_latency_that_is_none_is_refused(capture: Path, latency: str) -> None:
    with pytest.raises(UsageError, match="write recorded, none, sampled, or a time such as 5ms"):
        _slave(capture, latency=latency)


def test_a_latency_that_no_master_waits_for_is_refused(capture: Path) -> None:
    assert _delay_ns(_slave(capture, latency="1000s")) == MAX_LATENCY_NS
    with pytest.raises(UsageError, match=r"--latency 1000\.1s: .* write 1000s at most"):
        _slave(capture, latency="1000.1s")


def test_a_clock_that_is_as_fast_as_can_be_is_refused(capture: Path) -> None:
    with pytest.raises(UsageError, match="--match time goes by the recording's clock"):
        _slave(capture, match=MatchStrategy.TIME, rate=None)


def test_a_window_without_a_request_is_refused(capture: Path) -> None:
    with pytest.raises(InputError, match="an answer for in the part from 99 s on; give"):
        _slave(capture, window=TimeRange(99_000_000_000))


def test_what_the_recording_does_not_know_is_the_profiles() -> None:
    """The alive check of an FA3 is 600 s at first; behind 4FFFH it has nothing."""
    path = OURS / "fa3-at1m8x-setup.mcap"
    with _slave(path, rate=None).shell as shell:
        assert isinstance(shell, TcpSlave)
        with open_master(TcpLink(shell.endpoint), MASTER_TIMEOUT_NS) as master:
            assert master.ask(0, bytes.fromhex("03 00F2 0001")) == bytes.fromhex("03 02 0258")
            assert master.ask(0, bytes.fromhex("03 5000 0001")) == bytes.fromhex("83 02")
    with _slave(path, rate=None, match=MatchStrategy.KEY).shell as shell:
        assert isinstance(shell, TcpSlave)
        with open_master(TcpLink(shell.endpoint), MASTER_TIMEOUT_NS) as master:
            assert master.ask(0, bytes.fromhex("03 00F2 0001")) == bytes.fromhex("83 02")


def test_faults_stand_before_the_recording(capture: Path, tmp_path: Path) -> None:
    faults = tmp_path / "faults.toml"
    faults.write_text('[[faults]]\nkind = "exception"\ncode = 6\nnth = 2\ntimes = 1\n')
    with _slave(capture, fault_file=faults, rate=None).shell as shell:
        assert isinstance(shell, TcpSlave)
        with open_master(TcpLink(shell.endpoint), MASTER_TIMEOUT_NS) as master:
            assert [master.ask(1, READ) for _ in range(3)] == [VALUES, b"\x83\x06", VALUES]


def test_it_can_be_steered_while_it_answers(capture: Path) -> None:
    slave = _slave(capture)
    assert slave.progress().is_waiting
    _delay_ns(slave)
    slave.control(Control.PAUSE)
    progress = slave.progress()
    assert (progress.is_paused, progress.is_waiting, progress.done) == (True, False, "1 asked")


def test_a_wrong_crc_of_the_recording_comes_again_where_it_is_wanted() -> None:
    path = OURS / "torn-and-glued-frames.mcap"
    wrong = bytes.fromhex("01 03 04 12 34 56 78 81 f8")
    link = parse_link("rtu+tcp:127.0.0.1:0")
    for with_damage, expected in ((True, [wrong]), (False, [])):
        run = SlaveRun(str(path), SlaveOptions(with_damage=with_damage, rate=None))
        slave = run.create_slave(link)
        answers = [slave.respond(1, READ, 0) for _ in range(8)]
        damaged = [
            wire_pieces(answer, Transport.RTU_TCP, 1)[0][1]
            for answer in answers
            if answer is not None and answer.distortion is not None
        ]
        assert damaged == expected


def _delay_ns(slave: PlayedSlave) -> int:
    answer = slave.respond(1, READ, 0)
    assert answer is not None
    assert answer.pdu == VALUES
    return answer.delay_ns
