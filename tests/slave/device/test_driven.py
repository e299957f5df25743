"""Values that move by themselves, on a clock of the test's own."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mbtool.devices import load_profile
from mbtool.slave.device.driven import DrivenDevice
from mbtool.slave.device.image import RegisterImage
from mbtool.slave.device.image_file import load_image
from mbtool.slave.families import make_device

if TYPE_CHECKING:
    from pathlib import Path

S = 1_000_000_000
BEGIN_NS = 1_700_000_000 * S
"""The slave's clock begins anywhere."""


def _driven(path: Path, text: str, name: str = "idec-ft1a-touch") -> DrivenDevice:
    profile = load_profile(name)
    image = RegisterImage.of(profile)
    file = path / "start.toml"
    file.write_text(text)
    driven = load_image(file, profile, image)
    return DrivenDevice(make_device(profile, image), driven)


def _ask(slave: DrivenDevice, request: str, at_s: float) -> str:
    answer = slave.respond(1, bytes.fromhex(request), BEGIN_NS + round(at_s * S))
    assert answer is not None
    return answer.pdu.hex(" ")


def test_a_value_is_that_of_the_moment_of_each_request(tmp_path: Path) -> None:
    slave = _driven(tmp_path, "HR400001 = { ramp = [0, 1000], seconds = 10 }\nHR400002 = 7")
    for at_s, value in ((0, 0), (1, 100), (1.5, 150), (9.99, 999), (10, 0)):
        registers = f"{value >> 8:02x} {value & 0xFF:02x} 00 07"
        assert _ask(slave, "03 0000 0002", at_s) == f"03 04 {registers}"


def test_a_bit_can_move_too(tmp_path: Path) -> None:
    slave = _driven(tmp_path, "C1 = { ramp = [0, 1], seconds = 2 }")
    assert [_ask(slave, "01 0000 0001", at_s)[-1] for at_s in (0, 0.9, 1.1, 2.1)] == list("0010")


def test_what_a_master_writes_to_a_moving_value_does_not_stay(tmp_path: Path) -> None:
    slave = _driven(tmp_path, "HR400001 = { ramp = [0, 1000], seconds = 10 }")
    _ask(slave, "06 0000 1234", 1)
    assert _ask(slave, "03 0000 0001", 1) == "03 02 12 34"
    assert _ask(slave, "03 0000 0001", 2) == "03 02 00 64"


def test_a_module_averages_what_its_input_was_between_two_requests(tmp_path: Path) -> None:
    text = '"CH1 digital operation value" = { ramp = [0, 16000], seconds = 4 }'
    slave = _driven(tmp_path, text, "fa3-at1m8x")
    _ask(slave, "06 0105 0001", 0)  # CH1: time average
    _ask(slave, "06 0107 0FA0", 0)  # of 4000 ms
    _ask(slave, "05 0009 FF00", 0)
    half = int(_ask(slave, "04 0002 0001", 4)[6:].replace(" ", ""), 16)
    assert 7800 <= half <= 8000
