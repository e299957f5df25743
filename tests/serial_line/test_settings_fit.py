"""How well line settings explain what was heard."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mbtool.core import Direction, LineSettings, SerialFormat
from mbtool.modbus.adu import ascii_adu, rtu_adu
from mbtool.modbus.pdu import encode_pdu
from mbtool.serial_line.settings_fit import (
    ENOUGH_BYTES,
    ENOUGH_WITHOUT_FRAME,
    SettingsScore,
    SettingsTrial,
    other_parity,
    settings_to_try,
)

MS = 1_000_000
EVEN = SerialFormat(19200, 8, "E", 1)
NONE = SerialFormat(9600, 8, "N", 1)
READ = encode_pdu(3, Direction.REQUEST, address=0, quantity=2)


def heard(
    heard_as: SerialFormat, *reads: bytes, damaged: bool = False, only_ascii: bool = False
) -> SettingsTrial:
    trial = SettingsTrial(heard_as, only_ascii=only_ascii)
    at_ns = 10**9
    for data in reads:
        trial.feed(data, range(len(data)) if damaged else (), at_ns)
        trial.advance(at_ns + 90 * MS)
        at_ns += 100 * MS
    return trial


def with_parity(data: bytes, parity: str) -> bytes:
    """Seven bits and their parity as eight bits without."""
    odd = parity == "O"
    high = [1 if parity == "N" else (byte.bit_count() + odd) % 2 for byte in data]
    return bytes(byte | bit << 7 for byte, bit in zip(data, high, strict=True))


def best(trial: SettingsTrial) -> SettingsScore:
    return trial.scores()[0]


def test_three_frames_are_sure() -> None:
    trial = heard(EVEN, *[rtu_adu(1, READ)] * 3)
    assert best(trial).is_sure
    assert trial.is_decided
    assert str(best(trial)) == "19200-8E1 RTU: 3 of 3 frames have a correct CRC"


def test_two_frames_are_likely_and_one_is_nothing() -> None:
    two, one = (best(heard(EVEN, *[rtu_adu(1, READ)] * count)) for count in (2, 1))
    assert (two.is_sure, two.is_likely) == (False, True)
    assert not one.is_likely


def test_frames_whose_every_byte_is_damaged_explain_nothing() -> None:
    score = best(heard(EVEN, *[rtu_adu(1, READ)] * 9, damaged=True))
    assert (score.frames, score.fit, score.is_likely) == (9, 0, False)
    assert str(score) == ("19200-8E1 RTU: 9 of 9 frames have a correct CRC, 72 of 72 bytes damaged")


def test_noise_lowers_the_fit_by_its_bytes() -> None:
    frame = rtu_adu(1, READ)
    score = best(heard(EVEN, frame, bytes(8), frame, frame))
    assert score.fit == 0.75
    assert str(score).startswith("19200-8E1 RTU: 3 of 4 frames")


@pytest.mark.parametrize(("parity", "stop_bits"), [("E", 1), ("O", 1), ("N", 2)])
def test_ascii_with_seven_bits_is_read_from_eight(parity: str, stop_bits: int) -> None:
    score = best(heard(NONE, *[with_parity(ascii_adu(1, READ), parity)] * 3))
    assert score.settings.ascii
    assert score.settings.format == SerialFormat(9600, 7, parity, stop_bits)
    assert score.is_sure


@pytest.mark.parametrize("heard_as", [EVEN, NONE, SerialFormat(9600, 8, "O", 1)])
def test_ascii_with_eight_bits_is_known_by_its_high_bit(heard_as: SerialFormat) -> None:
    score = best(heard(heard_as, *[ascii_adu(1, READ)] * 3))
    assert (score.settings.ascii, score.settings.format) == (True, heard_as)
    assert str(score).endswith("3 of 3 frames have a correct LRC")


def test_rtu_frames_do_not_count_if_only_ascii_is_tried() -> None:
    assert not best(heard(EVEN, *[rtu_adu(1, READ)] * 3, only_ascii=True)).frames


def test_settings_without_a_frame_are_given_up_early_and_noisy_ones_late() -> None:
    assert not heard(EVEN, bytes(ENOUGH_WITHOUT_FRAME - 1)).is_decided
    assert heard(EVEN, bytes(ENOUGH_WITHOUT_FRAME)).is_decided
    frame, noise = rtu_adu(1, READ), b"\x55" * 8
    some = [frame, noise] * (ENOUGH_BYTES // 16)
    assert not heard(EVEN, *some[:30]).is_decided
    assert heard(EVEN, *some, noise).is_decided


def test_the_standards_default_is_heard_first_and_nothing_twice() -> None:
    to_hear = settings_to_try()
    assert to_hear[0] == EVEN
    assert len(set(to_hear)) == len(to_hear) == 24


def test_formats_are_heard_in_the_order_of_their_use() -> None:
    bauds = (19200, 9600, 115200, 38400, 57600, 4800, 2400, 1200)
    usual = [f"{baud}-8{parity}1" for baud in bauds for parity in "EN"]
    assert [str(one) for one in settings_to_try()] == [*usual, *(f"{baud}-8O1" for baud in bauds)]


def scored(frames: int, framed: int, damaged: int = 0) -> SettingsScore:
    """Of 100 bytes heard."""
    return SettingsScore(LineSettings(EVEN), frames, 0, framed, 100, damaged)


def test_settings_are_sure_from_nine_tenths_on_and_likely_from_three_tenths_on() -> None:
    assert [scored(3, framed).is_sure for framed in (89, 90)] == [False, True]
    assert [scored(2, framed).is_likely for framed in (29, 30)] == [False, True]
    assert [scored(frames, 100).is_sure for frames in (2, 3)] == [False, True]
    assert [scored(frames, 100).is_likely for frames in (1, 2)] == [False, True]


def test_each_damaged_byte_lowers_the_fit_to_zero_at_the_least() -> None:
    fits = [scored(9, 80, damaged).fit for damaged in (0, 25, 100, 101, 150)]
    assert fits == [0.8, 0.8 * 0.75, 0, 0, 0]
    assert SettingsScore(LineSettings(EVEN), 0, 0, 0, 0, 0).fit == 0


def test_damaged_bytes_of_seven_bits_are_those_marked_or_of_the_wrong_parity() -> None:
    frame = with_parity(ascii_adu(1, READ), "E")
    trial = SettingsTrial(NONE)
    trial.feed(frame, (0, 3), 10**9)
    damaged = {str(one.settings.format): one.damaged for one in trial.scores()}
    assert (trial.heard, trial.marked) == (len(frame), 2)
    assert (damaged["9600-7E1"], damaged["9600-7O1"]) == (2, len(frame))
    assert damaged["9600-8N1"] == 2
    lacking = sum(byte < 0x80 for at, byte in enumerate(frame) if at not in (0, 3)) + 2
    assert damaged["9600-7N2"] == lacking


@pytest.mark.parametrize(("count", "is_decided"), [(199, False), (200, True)])
def test_settings_of_a_bad_fit_are_given_up_after_200_bytes(count: int, is_decided: bool) -> None:
    frame = rtu_adu(1, READ)
    trial = heard(EVEN, frame, frame, *[b"\x55" * 8] * 22, b"\x55" * (count - 192))
    assert best(trial).frames == 2
    assert trial.is_decided is is_decided


def test_the_other_parity_of_even_is_odd() -> None:
    assert str(other_parity(EVEN)) == "19200-8O1"
    assert other_parity(other_parity(EVEN)) == EVEN


@given(st.lists(st.binary(max_size=60), max_size=20), st.sampled_from([EVEN, NONE]), st.booleans())
def test_fit_is_always_a_share(reads: list[bytes], heard_as: SerialFormat, damaged: bool) -> None:
    trial = heard(heard_as, *reads, damaged=damaged)
    assert trial.heard == sum(map(len, reads))
    assert all(0 <= score.fit <= 1 for score in trial.scores())
