"""Recordings of logic analysers, as sigrok writes them."""

from __future__ import annotations

import io
import zipfile
from random import Random
from typing import TYPE_CHECKING

import pytest

from mbtool.core import InputError, LineSettings, SerialFormat, parse_line
from mbtool.modbus import rtu_adu
from mbtool.sources.files import CaptureKind, open_capture
from mbtool.sources.sigrok import is_sigrok, read_sigrok
from tests.sources.uart import edges_of

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

RATE = 1_000_000
REQUEST = bytes.fromhex("01 03 0063 0001 7414")  # unit 1, read holding register 99, CRC
RESPONSE = bytes.fromhex("01 03 02 0201 78e4")
BOTH = [(2_000_000, REQUEST), (12_000_000, RESPONSE)]
"""What is sent, and when it begins in ns."""
Sent = list[tuple[int, bytes]]


def samples(
    channels: Mapping[int, Sent],
    line: SerialFormat,
    *,
    unit: int = 1,
    inverted: Sequence[int] = (),
    length: int = 30_000,
) -> bytes:
    """The samples of channels, each with what is sent on it; the other channels are low."""
    levels = [0] * length
    for channel, sent in channels.items():
        edges = iter([*(ns * RATE // 10**9 for ns in edges_of(sent, line)), length])
        level, edge = 1, next(edges)
        for at in range(length):
            while at >= edge:
                level, edge = 1 - level, next(edges)
            levels[at] |= (level ^ (channel in inverted)) << channel
    return b"".join(level.to_bytes(unit, "little") for level in levels)


def recording(
    data: bytes,
    *,
    unit: int = 1,
    parts: int = 1,
    rate: str = "1 MHz",
    packed: int = zipfile.ZIP_DEFLATED,
) -> bytes:
    """A file with these samples."""
    out = io.BytesIO()
    probes = "".join(f"probe{number + 1}=D{number}\n" for number in range(8 * unit))
    with zipfile.ZipFile(out, "w", packed) as archive:
        archive.writestr("version", "2")
        archive.writestr(
            "metadata",
            "[global]\nsigrok version=0.5.2\n\n[device 1]\ncapturefile=logic-1\n"
            f"total probes={8 * unit}\nsamplerate={rate}\ntotal analog=0\n{probes}"
            f"unitsize={unit}\n",
        )
        size = -(-len(data) // parts)
        for number in range(parts):
            part = data[number * size : (number + 1) * size]
            archive.writestr(f"logic-1-{number + 1}", part)
    return out.getvalue()


def _read(data: bytes, line: LineSettings | None = None) -> tuple[SerialFormat, Sent]:
    """The line's settings, and each byte with the time when it begins."""
    settings, pieces = read_sigrok(io.BytesIO(data), "a.sr", "a", line)
    character_ns = settings.format.character_ns
    return settings.format, [(one.ts_ns - character_ns, one.data) for one in pieces]


@pytest.mark.parametrize("baud", [1200, 9600, 19200, 115200])
@pytest.mark.parametrize("settings", ["8E1", "8O1", "8N1", "8N2"])
def test_the_signal_shows_its_bytes_and_the_settings_of_the_line(baud: int, settings: str) -> None:
    line = SerialFormat.parse(f"{baud}-{settings}")
    character_ns = line.character_ns
    sent = [(2_000_000, REQUEST), (2_000_000 + 20 * character_ns, RESPONSE)]
    length = (2_000_000 + 32 * character_ns) // 1000
    found, heard = _read(recording(samples({2: sent}, line, length=length)))
    assert str(found) == f"{baud}-{settings.replace('N2', 'N1')}"
    assert b"".join(data for _, data in heard) == REQUEST + RESPONSE
    for number, (ts_ns, _) in enumerate(heard[: len(REQUEST)]):
        assert ts_ns == pytest.approx(2_000_000 + number * character_ns, abs=2000)


@pytest.mark.parametrize(("unit", "channel"), [(1, 0), (1, 7), (2, 11)])
@pytest.mark.parametrize("parts", [1, 7])
def test_samples_may_have_several_bytes_and_several_parts(
    unit: int, channel: int, parts: int
) -> None:
    data = samples({channel: BOTH}, SerialFormat(), unit=unit)
    _, heard = _read(recording(data, unit=unit, parts=parts))
    assert b"".join(one for _, one in heard) == REQUEST + RESPONSE


def test_two_wires_are_one_line_in_the_order_of_time() -> None:
    data = samples({1: BOTH[1:], 4: BOTH[:1]}, SerialFormat())
    _, heard = _read(recording(data))
    assert b"".join(one for _, one in heard) == REQUEST + RESPONSE
    assert [ts_ns for ts_ns, _ in heard] == sorted(ts_ns for ts_ns, _ in heard)


def test_the_second_wire_of_rs485_and_an_echo_are_left_out() -> None:
    data = samples({0: BOTH, 1: BOTH, 2: BOTH[:1]}, SerialFormat(), inverted=[1])
    _, heard = _read(recording(data))
    assert b"".join(one for _, one in heard) == REQUEST + RESPONSE


def test_an_inverted_channel_alone_is_read() -> None:
    data = samples({3: BOTH}, SerialFormat(), inverted=[3])
    _, heard = _read(recording(data))
    assert b"".join(one for _, one in heard) == REQUEST + RESPONSE


@pytest.mark.parametrize("pulse", [3, 9, 52])
def test_a_clock_on_another_channel_is_no_line(pulse: int) -> None:
    data = samples({0: BOTH}, SerialFormat())
    clocked = bytes(byte | (at // pulse % 2) << 5 for at, byte in enumerate(data))
    _, heard = _read(recording(clocked))
    assert b"".join(one for _, one in heard) == REQUEST + RESPONSE


def test_what_the_user_says_of_the_line_counts() -> None:
    line = parse_line("ascii@9600-7E1")
    text = b":010300630001"
    data = samples({0: [(2_000_000, text)]}, line.format)
    found, heard = _read(recording(data), line)
    assert found == line.format
    assert b"".join(one for _, one in heard) == text


def test_a_disturbance_and_a_break_are_no_bytes() -> None:
    data = bytearray(samples({0: BOTH}, SerialFormat()))
    data[500:505] = bytes(5)
    data[20_000:25_000] = bytes(5_000)
    _, heard = _read(recording(bytes(data)))
    assert b"".join(one for _, one in heard) == REQUEST + RESPONSE


def test_a_byte_with_a_wrong_parity_is_a_byte() -> None:
    data = bytearray(samples({0: BOTH}, SerialFormat()))
    begin = 2_000 + round(9 * RATE / 19200)  # The parity bit of the first byte, which is 1.
    data[begin : begin + 52] = bytes(52)
    found, heard = _read(recording(bytes(data)))
    assert found == SerialFormat()
    assert b"".join(one for _, one in heard) == REQUEST + RESPONSE


def test_a_recording_without_characters_is_told_in_one_line() -> None:
    for data in (bytes(1000), b"\xff" * 1000, b"\x01\x00" * 500):
        with pytest.raises(InputError, match="no channel carries characters"):
            _read(recording(data))


def test_settings_that_do_not_fit_the_signal_are_told() -> None:
    data = recording(samples({0: BOTH}, SerialFormat(9600)))
    message = "no channel carries characters of 9600-8N1; its signal is that of 9600-8E1"
    with pytest.raises(InputError, match=message):
        _read(data, LineSettings(SerialFormat(9600, 8, "N", 1)))


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (recording(b"")[:200], "no recording of sigrok that can be read: File is not a zip file"),
        (recording(b"", rate="fast"), "the sample rate is 'fast'"),
        (recording(b"", rate="0 Hz"), "no logic samples with a sample rate"),
        (recording(bytes(99), unit=9), "no logic samples with a sample rate"),
        (recording(bytes(99), packed=zipfile.ZIP_BZIP2), "not packed with deflate"),
    ],
)
def test_a_file_that_cannot_be_used_is_refused(data: bytes, message: str) -> None:
    with pytest.raises(InputError, match=message):
        _read(data)


def test_too_few_samples_for_the_baud_rate_are_told() -> None:
    data = recording(samples({0: BOTH}, SerialFormat()))
    with pytest.raises(InputError, match="1000000 samples a second are too few for 460800 baud"):
        _read(data, LineSettings(SerialFormat(460800)))


def test_a_signal_with_more_edges_than_a_file_may_have_is_refused(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("mbtool.sources.sigrok.MAX_EDGES", 10)
    monkeypatch.setattr("mbtool.sources.sigrok.EDGES_A_BYTE", 0)
    with pytest.raises(InputError, match="edges, which no serial line has"):
        _read(recording(samples({0: BOTH}, SerialFormat())))


def test_samples_that_unpack_to_more_than_deflate_can_pack_are_refused() -> None:
    data = recording(bytes(5_000), parts=1)
    # The central directory says that the part has many more bytes.
    at = data.rindex(b"logic-1-1") - 46 + 24
    wrong = data[:at] + (1 << 30).to_bytes(4, "little") + data[at + 4 :]
    with pytest.raises(InputError, match="more than can be packed so"):
        _read(wrong)


def test_a_damaged_file_is_told_in_one_line_and_raises_nothing_else() -> None:
    random = Random(7)
    whole = recording(samples({0: BOTH}, SerialFormat()), parts=3)
    refused = 0
    for _ in range(300):
        data = bytearray(whole)
        for _ in range(random.randint(1, 4)):
            data[random.randrange(len(data))] = random.randrange(256)
        told = _told(bytes(data[: random.choice((len(data), random.randrange(len(data))))]))
        refused += told is not None
        assert told is None or (told.startswith("a.sr: ") and "\n" not in told)
    assert refused > 100


def _told(data: bytes) -> str | None:
    try:
        _read(data)
    except InputError as error:
        return str(error)
    return None


def test_a_file_is_known_by_its_first_bytes(tmp_path: Path) -> None:
    data = recording(samples({0: BOTH}, SerialFormat()))
    assert is_sigrok(data[:64])
    other = io.BytesIO()
    with zipfile.ZipFile(other, "w") as archive:
        archive.writestr("a.txt", "text")
    assert not is_sigrok(other.getvalue()[:64])
    path = tmp_path / "line.bin"
    path.write_bytes(data)
    with open_capture(path) as capture:
        assert capture.kind is CaptureKind.SIGROK
        line, pieces = capture.serial(None)
        assert (str(line.format), len(list(pieces))) == ("19200-8E1", 15)


def test_the_bus_of_a_recording_that_rests_low_is_read_upright() -> None:
    """As with a transceiver whose output floats low while nobody sends."""
    line = SerialFormat()
    data = bytearray(samples({0: BOTH[:1], 1: BOTH[1:], 2: BOTH}, line, length=60_000))
    character = line.character_ns * RATE // 10**9
    for at in range(len(data)):
        is_sent = any(
            ns * RATE // 10**9 - 100 <= at <= ns * RATE // 10**9 + (len(sent) + 1) * character
            for ns, sent in BOTH
        )
        if not is_sent:
            data[at] &= ~4
    _, heard = _read(recording(bytes(data)))
    assert b"".join(one for _, one in heard) == REQUEST + RESPONSE


def test_characters_that_are_no_modbus_are_refused_unless_the_settings_are_named() -> None:
    text = b"$GPGGA,081836,3751.65,S,14507.36,E*75\r\n"
    data = recording(samples({0: [(2_000_000, text)]}, SerialFormat(), length=40_000))
    with pytest.raises(InputError, match=r"are not Modbus RTU; .* --link rtu@19200-8E1"):
        _read(data)
    _, heard = _read(data, LineSettings(SerialFormat()))
    assert b"".join(one for _, one in heard) == text


def test_a_frame_with_a_correct_crc_by_chance_makes_no_line_of_other_characters() -> None:
    alone = bytes.fromhex("6f fb 6f 6f db 6f")
    frame = rtu_adu(alone[0], alone[1:])
    sent = [(2_000_000, frame)]
    with pytest.raises(InputError, match="are not Modbus RTU"):
        _read(recording(samples({0: sent}, SerialFormat())))
