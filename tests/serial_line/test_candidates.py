"""The candidates at the offsets of a window."""

from __future__ import annotations

from mbtool.core import Direction
from mbtool.modbus.adu import DirectionBy
from mbtool.modbus.adu_bytes import rtu_adu
from mbtool.serial_line import costs
from mbtool.serial_line.bus_model import ROLES, BusModel, Classification
from mbtool.serial_line.candidates import ByteWindow, Candidates
from mbtool.serial_line.line_statistics import LearnedCost, LineStatistics

REQUEST, RESPONSE = Direction.REQUEST, Direction.RESPONSE
CHARACTER = 573_000
READ = rtu_adu(1, bytes.fromhex("03 0000 0002"))
ANSWER = rtu_adu(1, bytes.fromhex("03 04 0001 0002"))


def candidates(
    data: bytes, *heard: bytes, silent_at: tuple[int, ...] = (), glue: float = costs.GLUED
) -> tuple[Candidates, BusModel]:
    """The candidates of a window between two silences, after these requests were heard."""
    bus_model = BusModel()
    for raw in heard:
        bus_model.hear(Classification(REQUEST, DirectionBy.FORM, 1.0), raw[0], raw[1:-2], 0, 1)
    statistics = LineStatistics()
    statistics.glue = LearnedCost(glue, costs.GLUED_LIMITS)
    times = [(place + 1) * CHARACTER for place in range(len(data))]
    silences = [place in (0, len(data), *silent_at) for place in range(len(data) + 1)]
    window = ByteWindow(data, times, CHARACTER, silences, is_behind_noise=False, may_continue=True)
    return Candidates(window, bus_model, statistics, ROLES), bus_model


def flipped(raw: bytes, at: int, bit: int = 0) -> bytes:
    return raw[:at] + bytes([raw[at] ^ 1 << bit]) + raw[at + 1 :]


def repaired(data: bytes) -> list[tuple[bytes, Direction]]:
    found, bus_model = candidates(data, READ)
    return [(one.repaired, one.role) for one in found.damaged(0, bus_model.state) if one.repaired]


def test_frames_are_found_in_each_form_that_they_have() -> None:
    found, _ = candidates(READ + ANSWER)
    assert [(one.size, one.role, one.roles) for one in found.frames(0)] == [
        (8, REQUEST, (REQUEST,))
    ]
    assert [(one.size, one.role) for one in found.frames(8)] == [(9, RESPONSE)]
    assert found.frames(1) == []


def test_one_wrong_bit_is_repaired_wherever_it_is() -> None:
    for at in range(len(ANSWER)):
        for bit in range(8):
            assert (ANSWER, RESPONSE) in repaired(flipped(ANSWER, at, bit) + READ)


def test_function_that_was_never_requested_is_not_repaired() -> None:
    found, bus_model = candidates(flipped(ANSWER, 1, 6) + READ)
    assert [one for one in found.damaged(0, bus_model.state) if one.repaired] == []


def test_wrong_bit_in_the_byte_count_is_repaired_if_no_byte_is_lost() -> None:
    damaged = flipped(ANSWER, 2, 1)  # Six bytes of registers instead of four.
    assert (ANSWER, RESPONSE) in repaired(damaged)
    assert repaired(damaged[:-1]) == []


def test_damaged_known_request_is_found_over_a_shorter_response() -> None:
    raw = next(
        raw
        for quantity in range(1, 256)
        if (raw := rtu_adu(1, bytes((1, 2, 7, 0, quantity))))[-1] == 0
    )
    damaged = raw[:-1] + b"\x04"
    sizes = [one.size for one in candidates(damaged, raw)[0].damaged_request(0)]
    assert sizes == [len(raw), len(raw) - 1]
    assert [one.size for one in candidates(raw[:-1], raw)[0].damaged_request(0)] == [len(raw) - 1]
    assert list(candidates(damaged)[0].damaged_request(0)) == []


def test_burst_is_one_damaged_frame_only_where_frames_are_never_glued() -> None:
    burst = b"\x11\x43\x55" + READ + b"\x77\x66"
    for glue, is_one in ((costs.NEVER_GLUED + 1, True), (costs.GLUED, False)):
        found, bus_model = candidates(burst, glue=glue)
        sizes = [one.size for one in found.damaged(0, bus_model.state)]
        assert (len(burst) in sizes) is is_one


def test_burst_of_a_frame_with_stray_bytes_is_no_damaged_frame() -> None:
    burst = b"\xff\xf8" + READ + b"\x00"
    found, bus_model = candidates(burst, glue=costs.NEVER_GLUED + 1)
    assert len(burst) not in [one.size for one in found.damaged(0, bus_model.state)]
