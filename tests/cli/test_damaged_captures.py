"""Commands read a capture as far as its damage, and tell the damage."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from mbtool.cli import exit_codes
from mbtool.modbus import mbap_adu
from tests.packets.building import Talk, pcap

if TYPE_CHECKING:
    from pathlib import Path

    from mbtool.core import Packet
    from tests.cli.program import CommandLine

HEADER = 16
"""Bytes in front of each packet of a pcap."""


@pytest.fixture
def whole(tmp_path: Path) -> Path:
    path = tmp_path / "whole.pcap"
    path.write_bytes(pcap(_packets()))
    return path


@pytest.fixture(params=["damaged", "cut"])
def broken(tmp_path: Path, request: pytest.FixtureRequest) -> Path:
    """The last record claims 4 GiB, or the file ends in it."""
    data = bytearray(pcap(_packets()))
    last = len(pcap(_packets()[:-1]))
    path = tmp_path / f"{request.param}.pcap"
    if request.param == "damaged":
        data[last + 8 : last + HEADER] = b"\xff" * 8
    path.write_bytes(data if request.param == "damaged" else data[: last + HEADER + 1])
    return path


def _packets() -> list[Packet]:
    talk = Talk()
    packets = talk.handshake()
    for number in range(5):
        packets.append(talk.request(mbap_adu(number, 1, bytes.fromhex("03 0000 0001"))))
        packets.append(talk.response(mbap_adu(number, 1, bytes.fromhex("03 02 1234"))))
    return [*packets, *talk.goodbye()]


def _tells(text: str, path: Path) -> bool:
    why = "damaged after packet " if path.stem == "damaged" else "ends in the middle of a record"
    return f"{path}: {why}" in text


def test_diff_compares_what_is_there(mbtool: CommandLine, whole: Path, broken: Path) -> None:
    told = mbtool("diff", whole, broken)
    assert told.code == exit_codes.DONE
    assert "5 transactions of" in told.err
    assert _tells(told.err, broken)


@pytest.mark.parametrize("arguments", [["--match"], ["draft"]])
def test_devices_shows_what_is_there_before_the_error(
    mbtool: CommandLine, broken: Path, arguments: list[str]
) -> None:
    told = mbtool("devices", *arguments, broken)
    assert told.code == exit_codes.UNREADABLE
    assert "unit" in told.out
    assert _tells(told.err, broken)


def test_a_master_plays_what_is_there(mbtool: CommandLine, broken: Path) -> None:
    told = mbtool("replay", broken, "--as-master", "--to", "tcp:127.0.0.1:1", "--speed", "max")
    assert told.code == exit_codes.UNREADABLE
    assert _tells(told.err, broken)
    assert "playing what is there" in told.err


def test_a_capture_with_nothing_before_its_damage_is_refused(
    mbtool: CommandLine, tmp_path: Path
) -> None:
    path = tmp_path / "damaged.pcap"
    path.write_bytes(pcap([]) + b"\xff" * HEADER)
    for arguments in (["--match"], ["draft"]):
        told = mbtool("devices", *arguments, path)
        assert (told.code, told.out) == (exit_codes.UNREADABLE, "")
        assert told.err.count("\n") == 1
        assert _tells(told.err, path)
