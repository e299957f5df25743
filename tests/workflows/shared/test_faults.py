"""Faults of a file before a responder."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from mbtool.core import SerialLink, TcpLink, UsageError, parse_link
from mbtool.devices import load_profile
from mbtool.modbus import Response
from mbtool.workflows.shared.faults import faulty
from tests.slave.scripted import Scripted, echo

if TYPE_CHECKING:
    from pathlib import Path

TCP, RTU_TCP, LINE = (
    parse_link(text) for text in ("tcp:127.0.0.1:0", "rtu+tcp:127.0.0.1:0", "rtu:/dev/x@9600")
)


def _file(tmp_path: Path, *kinds: str, more: str = "") -> Path:
    path = tmp_path / "faults.toml"
    path.write_text("".join(f'[[faults]]\nkind = "{kind}"\n{more}\n' for kind in kinds))
    return path


@pytest.mark.parametrize("link", [TCP, RTU_TCP, LINE])
def test_a_fault_stands_before_the_responder(tmp_path: Path, link: TcpLink | SerialLink) -> None:
    slave = faulty(Scripted(echo), _file(tmp_path, "delay", more="ms = 3"), link)
    assert slave.respond(1, b"\x03\x00\x00\x00\x01", 0) == Response(
        b"\x03\x00\x00\x00\x01", 3_000_000
    )


def test_registers_are_written_as_the_profile_does(tmp_path: Path) -> None:
    path = _file(tmp_path, "no-answer", more='registers = "HR400001..400002"')
    slave = faulty(Scripted(echo), path, LINE, [load_profile("idec-ft1a-touch")])  # type: ignore[arg-type]
    answers = [slave.respond(1, bytes([3, 0, address, 0, 1]), 0) for address in (0, 2)]
    assert [answer is not None and answer.distortion is None for answer in answers] == [False, True]


@pytest.mark.parametrize(
    ("kind", "link", "reason"),
    [
        ("bad-crc", TCP, "Modbus/TCP has no checksum; use truncated or extra-bytes"),
        ("wrong-id", LINE, "only Modbus/TCP has transaction ids"),
        ("wrong-id", RTU_TCP, "only Modbus/TCP has transaction ids"),
        ("close", LINE, "a serial line has no connection to end"),
        ("reset", LINE, "a serial line has no connection to end"),
    ],
)
def test_what_a_link_cannot_do_is_refused_with_what_it_can(
    tmp_path: Path, kind: str, link: TcpLink | SerialLink, reason: str
) -> None:
    path = _file(tmp_path, "no-answer", kind)
    with pytest.raises(UsageError) as caught:
        faulty(Scripted(echo), path, link)
    assert str(caught.value).startswith(f"{path}: fault 2: {kind} on {link}: {reason}")


@pytest.mark.parametrize(
    ("kind", "link"),
    [
        ("bad-crc", RTU_TCP),
        ("bad-crc", LINE),
        ("wrong-id", TCP),
        ("close", TCP),
        ("reset", RTU_TCP),
    ],
)
def test_what_a_link_can_do_is_taken(tmp_path: Path, kind: str, link: TcpLink | SerialLink) -> None:
    slave = faulty(Scripted(echo), _file(tmp_path, kind), link)
    answer = slave.respond(1, b"\x03\x00\x00\x00\x01", 0)
    assert answer is not None
    assert answer.distortion is not None
