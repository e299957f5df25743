"""The settings that a new log records."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from mbtool.core import Direction, Endpoint, ListenTls, TapLink, TargetTls, UsageError, parse_link
from mbtool.devices import Assignments, NamedTransaction, parse_assignment, profile_from_json
from mbtool.logs import LogReader, Rotation
from mbtool.logs.opening import create_log
from mbtool.modbus import Transport, rtu_adu
from mbtool.workflows.shared.reading import Reading, ReadingOptions
from tests.workflows.evidence import CONNECTION, READ, VALUES, captured, relayed

FORMAT = Path(__file__).parents[2] / "docs" / "log-format.md"
LINKS = [
    parse_link(text)
    for text in (
        "rtu:/dev/ttyUSB0@9600-8N2",
        "ascii:/dev/ttyUSB1@9600-7E1",
        "net:eth0",
        "tap:127.0.0.1:1502=10.0.0.9:4001",
        "tap:127.0.0.1:1503=10.0.0.8:502",
    )
]
LINKS.append(
    TapLink(
        Endpoint("127.0.0.1", 1802),
        Endpoint("10.0.0.7", 802),
        listen_tls=ListenTls("tap.pem"),
        target_tls=TargetTls("ca.pem"),
    )
)
DEVICES = Assignments(
    [parse_assignment("1=idec-ft1a-touch"), parse_assignment("10.0.0.8/5=fa3-at1m8x")]
)


def test_a_log_has_all_settings_to_decode_it_again(tmp_path: Path) -> None:
    path = str(tmp_path / "a.mcap")
    create_log(path, LINKS, DEVICES, ports=[502, 1502], rtu_ports=[4001]).close()
    with LogReader.open(path) as log:
        assert list(log.items()) == []
        assert log.links == {
            "ttyUSB0": {"spec": "rtu:/dev/ttyUSB0@9600-8N2"},
            "ttyUSB1": {"spec": "ascii:/dev/ttyUSB1@9600-7E1"},
            "eth0": {"spec": "net:eth0", "ports": "502 1502", "rtu_ports": "4001"},
            "10.0.0.9:4001": {"spec": "tap:127.0.0.1:1502=10.0.0.9:4001", "rtu_ports": "4001"},
            "10.0.0.8": {"spec": "tap:127.0.0.1:1503=10.0.0.8:502"},
            "10.0.0.7:802": {"spec": "tap:127.0.0.1:1802=10.0.0.7:802", "tls": "master slave"},
        }
        assert log.devices == {"10.0.0.8/5": "fa3-at1m8x", "1": "idec-ft1a-touch"}
        attached = [profile_from_json(data, name) for name, data in log.profiles.items()]
        assert attached == list(DEVICES.profiles)
        assert {"host", "system", "command", "clock", "version"} <= set(log.capture)


def test_all_metadata_of_a_log_is_documented(tmp_path: Path) -> None:
    rows = {
        cells[1].strip(" `"): cells[2]
        for cells in (line.split("|") for line in FORMAT.read_text().splitlines())
        if len(cells) == 4
    }
    path = str(tmp_path / "a.mcap")
    create_log(path, LINKS, DEVICES, ports=[502], rtu_ports=[4001]).close({"discarded_bytes": "0"})
    with LogReader.open(path) as log:
        list(log.items())
        said = {
            "mbtool.capture": set(log.capture),
            "mbtool.link": {"name"}.union(*log.links.values()),
        }
    for record, keys in said.items():
        assert {key for key in keys if f"`{key}`" not in rows[record]} == set()


def test_evidence_alone_is_decoded_again_with_the_logs_settings(tmp_path: Path) -> None:
    path = str(tmp_path / "a.mcap")
    links = [parse_link("net:eth0"), parse_link("tap:127.0.0.1:0=10.0.0.9:4001")]
    log = create_log(path, links, DEVICES, ports=[1502, 502], rtu_ports=[4001])
    for packet in captured(1):
        log.write(packet)
    connection = replace(CONNECTION, slave=Endpoint("10.0.0.9", 4001))
    for at, direction, pdu in ((0, Direction.REQUEST, READ), (9, Direction.RESPONSE, VALUES)):
        chunk = relayed(at, direction, pdu, connection=connection)
        log.write(replace(chunk, data=rtu_adu(1, pdu)))
    log.close()
    records = Reading([path], ReadingOptions(raw=True)).records()
    found = [one for one in records if isinstance(one, NamedTransaction)]
    assert [(one.transport, one.device, one.outcome.value) for one in found] == [
        (Transport.TCP, "idec-ft1a-touch", "ok"),
        (Transport.RTU_TCP, "idec-ft1a-touch", "ok"),
    ]


def test_a_log_rotates_if_the_user_wants_it(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    log = create_log(str(path), LINKS, DEVICES, rotation=Rotation.parse("1s"))
    for second in range(3):
        for packet in captured(1):
            log.write(packet)
        log.tick(second * 1_000_000_000)
    log.close()
    parts = sorted(one.name for one in tmp_path.iterdir())
    assert len(parts) >= 2
    for part in parts:
        with LogReader.open(tmp_path / part) as reader:
            list(reader.items())
            assert len(reader.links) == len(LINKS)
            assert len(reader.profiles) == 2


def test_an_existing_log_is_not_overwritten(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    path.write_text("mine")
    with pytest.raises(UsageError, match=r"a\.mcap: the file exists"):
        create_log(str(path), LINKS, DEVICES)
    assert path.read_text() == "mine"


@pytest.mark.parametrize(
    ("name", "right"),
    [
        ("x.pcap", "x.mcap"),
        ("x.PCAPNG", "x.mcap"),
        ("a.b.jsonl", "a.b.mcap"),
        ("x.csv", "x.mcap"),
    ],
)
def test_a_suffix_of_another_format_is_an_error(tmp_path: Path, name: str, right: str) -> None:
    with pytest.raises(UsageError) as caught:
        create_log(str(tmp_path / name), LINKS, DEVICES)
    assert str(caught.value) == (
        f"{tmp_path / name}: a log is an MCAP file: name it {tmp_path / right}"
    )
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", ["x.mcap", "x", "x.log", "2026.11.21"])
def test_a_log_may_have_any_other_name(tmp_path: Path, name: str) -> None:
    create_log(str(tmp_path / name), LINKS, DEVICES).close()
    assert (tmp_path / name).exists()


@pytest.mark.parametrize("rotation", ["often", "0MB", "100", ""])
def test_a_wrong_rotation_leaves_no_log(tmp_path: Path, rotation: str) -> None:
    with pytest.raises(UsageError, match="for example 100MB or 1h"):
        create_log(str(tmp_path / "a.mcap"), LINKS, DEVICES, rotation=Rotation.parse(rotation))
    assert list(tmp_path.iterdir()) == []


def test_a_log_keeps_the_command_without_the_password_of_a_url(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("sys.argv", ["mbtool", "sniff", "--mqtt", "mqtt://plant:secret@broker/a"])
    create_log(str(tmp_path / "a.mcap"), LINKS[:1], Assignments()).close()
    assert b"secret" not in (tmp_path / "a.mcap").read_bytes()
    assert b"mqtt://plant:***@broker/a" in (tmp_path / "a.mcap").read_bytes()
