"""The choice of t1.5 and t3.5 for a serial line."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import pytest

from mbtool.core import Silence, UsageError, parse_link
from mbtool.core.link_spec import SerialLink
from mbtool.decode.decoder import Decoder
from mbtool.decode.line_timing import LineTiming
from mbtool.devices import Assignments, NamedTransaction, Namer, parse_assignment
from mbtool.logs.opening import create_log
from mbtool.modbus import Verdict, rtu_adu
from mbtool.workflows.shared.reading import Reading, ReadingOptions
from tests.workflows.evidence import LINE, WRITE, heard

if TYPE_CHECKING:
    from pathlib import Path

DEVICE = """
name = "{name}"
title = "A device"
vendor = "Maker"
transports = ["{transport}"]
source = "its manual"
functions = {{}}
areas = []

[timing]
{timing}
"""


def _line(text: str) -> SerialLink:
    link = parse_link(text)
    assert isinstance(link, SerialLink)
    return link


def _devices(folder: Path, *said: tuple[str, str, str]) -> Assignments:
    """Devices by WHO, transport and timing."""
    assignments = []
    for number, (who, transport, timing) in enumerate(said):
        path = folder / f"{number}.toml"
        path.write_text(DEVICE.format(name=f"d{number}", transport=transport, timing=timing))
        assignments.append(parse_assignment(f"{who}={path}"))
    return Assignments(assignments)


def test_without_options_and_profiles_the_standard_gives_the_silences() -> None:
    line = _line("rtu:/dev/a@9600-8E1")
    assert LineTiming().format_of(line) == line.format


def test_a_device_on_the_line_gives_the_silences(tmp_path: Path) -> None:
    timing = LineTiming(_devices(tmp_path, ("5", "rtu", 't3_5 = "28bits"')))
    assert str(timing.format_of(_line("rtu:/dev/a@9600-8E1"))) == "9600-8E1,t3.5=28bits"


@pytest.mark.parametrize(
    ("who", "transport"), [("10.0.0.9", "rtu"), ("5", "tcp"), ("all", "ascii")]
)
def test_a_device_that_cannot_be_on_the_line_does_not_count(
    tmp_path: Path, who: str, transport: str
) -> None:
    timing = LineTiming(_devices(tmp_path, (who, transport, 't3_5 = "28bits"')))
    line = _line("rtu:/dev/a@9600-8E1")
    assert timing.format_of(line) == line.format


def test_a_device_on_an_ascii_line_has_a_say_there(tmp_path: Path) -> None:
    timing = LineTiming(_devices(tmp_path, ("5", "ascii", 't3_5 = "28bits"')))
    assert str(timing.format_of(_line("ascii:/dev/a@9600-7E1"))) == "9600-7E1,t3.5=28bits"


def test_of_several_devices_the_shortest_silence_between_frames_counts(tmp_path: Path) -> None:
    timing = LineTiming(
        _devices(
            tmp_path,
            ("5", "rtu", 't3_5 = "28bits"\nt1_5 = "1ms"'),
            ("6", "rtu", 't3_5 = "5ms"\nt1_5 = "2ms"'),
            ("7", "rtu", 't1_5 = "4ms"'),  # Longer than that.
        )
    )
    assert str(timing.format_of(_line("rtu:/dev/a@9600"))) == "9600-8E1,t1.5=2ms,t3.5=28bits"


def test_the_link_outweighs_a_device_and_an_option_outweighs_the_link(tmp_path: Path) -> None:
    devices = _devices(tmp_path, ("5", "rtu", 't3_5 = "28bits"'))
    line = _line("rtu:/dev/a@9600-8E1,t3.5=5ms")
    assert LineTiming(devices).format_of(line) == line.format
    timing = LineTiming(devices, t3_5=Silence.parse("6ms"))
    assert str(timing.format_of(line)) == "9600-8E1,t3.5=6ms"
    assert [str(link) for link in timing.given([line])] == ["rtu:/dev/a@9600-8E1,t3.5=6ms"]


def test_a_devices_silence_that_contradicts_the_users_does_not_count(tmp_path: Path) -> None:
    devices = _devices(tmp_path, ("5", "rtu", 't3_5 = "1ms"'))
    timing = LineTiming(devices, t1_5=Silence.parse("2ms"))
    assert str(timing.format_of(_line("rtu:/dev/a@9600-8E1"))) == "9600-8E1,t1.5=2ms"


def test_silences_without_a_serial_line_are_the_users_mistake() -> None:
    timing = LineTiming(t3_5=Silence.parse("5ms"))
    with pytest.raises(UsageError, match="none of the links is one"):
        timing.given([parse_link("net:eth0")])
    assert LineTiming().given([parse_link("net:eth0")]) == [parse_link("net:eth0")]


def test_silences_that_contradict_the_link_are_the_users_mistake() -> None:
    timing = LineTiming(t3_5=Silence.parse("1ms"))
    with pytest.raises(UsageError, match=r"t1\.5 of 2ms is longer than t3\.5, 1ms"):
        timing.given([_line("rtu:/dev/a@9600-8E1,t1.5=2ms")])


def test_a_line_is_decoded_with_its_own_silences() -> None:
    # 3 ms inside a frame: more than t3.5 at 19200 baud, less than what is given.
    frame = rtu_adu(1, WRITE)
    halves = [replace(heard(0, WRITE), data=frame[:4]), replace(heard(5, WRITE), data=frame[4:])]
    nine = Silence.parse("9ms")

    def verdicts(line: SerialLink, timing: LineTiming) -> list[Verdict]:
        decoder = Decoder(Namer(), lines={line.name: line}, timing=timing)
        records = [record for half in halves for record in decoder.feed(half)]
        records += decoder.close()
        (record,) = records
        assert isinstance(record, NamedTransaction)
        return record.verdicts

    assert verdicts(LINE, LineTiming()) == [
        Verdict.SPLIT, Verdict.AMBIGUOUS, Verdict.CAPTURE_END,
    ]  # fmt: skip
    assert verdicts(LINE, LineTiming(t1_5=nine, t3_5=nine)) == [
        Verdict.AMBIGUOUS,
        Verdict.CAPTURE_END,
    ]
    line = replace(LINE, format=LINE.format.with_silences(nine, nine))
    assert verdicts(line, LineTiming()) == [Verdict.AMBIGUOUS, Verdict.CAPTURE_END]


def test_a_log_is_decoded_with_other_silences_only_from_its_raw_bytes(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    link = _line("rtu:/dev/rs485@19200-8E1,t3.5=9ms")
    log = create_log(str(path), [link], Assignments())
    frame = rtu_adu(1, WRITE)
    log.write(replace(heard(0, WRITE), data=frame[:4]))
    log.write(replace(heard(5, WRITE), data=frame[4:]))
    log.close({})
    nine = Silence.parse("9ms")
    with pytest.raises(UsageError, match="need --raw"):
        list(Reading([str(path)], ReadingOptions(t3_5=nine)).records())
    for options, verdict in (
        (ReadingOptions(raw=True), [Verdict.T1_5_BROKEN]),  # The log keeps what the LINK said.
        (ReadingOptions(raw=True, t1_5=nine), []),
        (ReadingOptions(raw=True, t3_5=Silence.parse("2ms")), [Verdict.SPLIT]),
    ):
        (record,) = Reading([str(path)], options).records()
        assert isinstance(record, NamedTransaction)
        assert record.verdicts == [*verdict, Verdict.AMBIGUOUS, Verdict.CAPTURE_END]
