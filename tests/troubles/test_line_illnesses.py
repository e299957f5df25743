"""Each illness of a serial line is named by its code, and healthy lines have none."""

from __future__ import annotations

from dataclasses import dataclass
from random import Random
from typing import TYPE_CHECKING

import pytest

from mbtool.core import SerialFormat
from mbtool.devices.checking.rules import Severity
from mbtool.modbus import rtu_adu
from mbtool.workflows.shared.unreadable_lines import UnreadableLines
from tests.troubles.lines import (
    EXACT,
    FTDI,
    LINE,
    MS,
    POLLED,
    START_NS,
    TIMINGS,
    Plant,
    Sent,
    judged,
    records_of,
    values_pdu,
)
from tests.uart import on_the_wire

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from mbtool.troubles.judge import Judgement
    from mbtool.troubles.trouble import Trouble

QUICK = {1: 8.0, 2: 12.0, 3: 20.0}
_REQUEST = 8
CHARACTER_NS = LINE.character_ns


def well(seconds: float = 60) -> list[Sent]:
    return Plant(latency=QUICK).run(seconds)


def is_request(one: Sent) -> bool:
    return len(one.data) == _REQUEST


def each(frames: Sequence[Sent], change: Callable[[Sent], list[Sent]]) -> list[Sent]:
    return [new for one in frames for new in change(one)]


def worst(judgement: Judgement) -> Trouble:
    assert judgement.troubles, judgement.summary
    return judgement.troubles[0]


def serious(judgement: Judgement) -> list[str]:
    """The codes of all troubles that are more than a note."""
    return [one.code for one in judgement.troubles if one.severity is not Severity.NOTE]


every_timing = pytest.mark.parametrize("timing", TIMINGS)


@every_timing
@pytest.mark.parametrize(
    "plant",
    [
        Plant(latency=QUICK),
        Plant(units=range(1, 9), latency={unit: 5.0 * unit for unit in range(1, 9)}, cycle=600),
        Plant(units=(1,), latency={1: 3}, cycle=50, pause=5),
        Plant(units=(1, 2), latency={1: 300, 2: 420}, timeout=1000, cycle=2000),
        Plant(units=(5, 6), latency={5: 2, 6: 2}, quantity=60, cycle=200),
    ],
    ids=["three units", "eight units", "one unit, often", "slow units", "long answers"],
)
def test_a_healthy_line_has_no_trouble(plant: Plant, timing: str) -> None:
    told = judged(plant.run(60), timing)
    assert plant.failed == 0
    # An FTDI adapter makes latencies look uneven, and silences short.
    assert [code for code in serious(told) if not code.startswith(("UNIT-SLOW", "RTU-10"))] == []


@every_timing
@pytest.mark.parametrize(
    ("plant", "seconds"),
    [
        (Plant(latency={**QUICK, 2: 700}), 60),
        (Plant(latency={**QUICK, 2: 550}, retries=1), 60),
        (Plant(units=(2,), latency={2: 700}, cycle=500), 60),
        (Plant(units=(2, 3), latency={2: 455, 3: 10}, timeout=470), 25),
    ],
    ids=["another unit next", "retried", "the same unit next", "now and then"],
)
def test_answers_after_the_time_out_are_late(plant: Plant, seconds: float, timing: str) -> None:
    told = judged(plant.run(seconds), timing)
    trouble = worst(told)
    assert (trouble.code, trouble.unit) == ("LINE-LATE", 2)
    assert trouble.count >= 3
    assert "MB-403" not in serious(told)
    assert "UNIT-MISSING" not in serious(told)


def test_a_late_unit_is_told_with_its_latency_and_the_masters_time_out() -> None:
    trouble = worst(judged(Plant(latency={**QUICK, 2: 700}).run(60)))
    assert trouble.sentence.startswith(
        "unit 2 answers 0.70 s after the request, the master waits 0.51 s: 60 of 60 answers come "
        "too late: "
        "raise the master's time-out above "
    )


def test_a_single_late_answer_is_a_note() -> None:
    def answer(plant: Plant, request: Sent, unit: int, pdu: bytes) -> list[Sent]:
        del pdu
        at_ns = request.end_ns(LINE) + round(QUICK[unit] * MS)
        if unit == 2 and 20_000 * MS < request.at_ns - START_NS < 21_000 * MS:
            at_ns += 700 * MS
        return [Sent(at_ns, rtu_adu(unit, values_pdu(plant.random, plant.quantity)))]

    told = judged(Plant(latency=QUICK, respond=answer).run(60))
    assert [(one.code, one.unit, one.severity) for one in told.troubles] == [
        ("LINE-LATE", 2, Severity.NOTE)
    ]
    assert ": 1 of 60 answers come too late" in told.troubles[0].cause


def test_a_dead_unit_is_told_beside_two_slaves_with_one_address() -> None:
    plant = TwoSlaves(units=(4, 1, 2), latency={1: 8, 2: 12, 4: 5}, other=16)

    def answer(_: Plant, request: Sent, unit: int, pdu: bytes) -> list[Sent]:
        return [] if unit == 4 else plant.both(plant, request, unit, pdu)

    plant.respond = answer
    told = judged(plant.run(60), POLLED)
    assert [(one.code, one.unit) for one in told.troubles] == [
        ("LINE-SAME-UNIT", 2), ("UNIT-SILENT", 4),
    ]  # fmt: skip


def test_the_unit_asked_before_is_told_if_its_second_answer_may_be_what_collides() -> None:
    plant = TwoSlaves(units=(4, 2, 1), latency={1: 8, 2: 12, 4: 5}, other=40)
    plant.respond = plant.both
    told = worst(judged(plant.run(60), POLLED))
    assert told.code == "LINE-SAME-UNIT"
    assert told.unit == 2 or "or as unit 2, which is asked right before it: " in told.cause


@every_timing
def test_a_dead_unit_is_told_beside_two_masters(timing: str) -> None:
    one = Plant(units=(1, 2, 5), latency={1: 8, 2: 12}, cycle=1000)
    other = Plant(units=(1, 3), latency={1: 8, 3: 30}, cycle=700, begin=333, seed=2)
    told = judged([*one.run(60), *other.run(60)], timing)
    assert ("UNIT-SILENT", 5) in [(one.code, one.unit) for one in told.troubles]


@every_timing
def test_two_masters_are_told_by_their_collisions(timing: str) -> None:
    one = Plant(units=(1, 2), latency={1: 8, 2: 12}, cycle=1000)
    other = Plant(units=(1, 3), latency={1: 8, 3: 30}, cycle=700, begin=333, seed=2)
    told = judged([*one.run(60), *other.run(60)], timing)
    assert worst(told).code == "LINE-TWO-MASTERS"
    assert worst(told).cause.endswith("one asks unit 3 every 700 ms, the other unit 2 every 1.00 s")


def mixed(frames: Sequence[Sent]) -> list[Sent]:
    """The frames where two programs share a port: none of their bytes is damaged, but those that
    are sent at the same time are mixed.
    """
    pieces: list[list[Sent]] = []
    end_ns = 0
    for one in sorted(frames, key=lambda one: one.at_ns):
        if one.at_ns >= end_ns:
            pieces.append([])
            end_ns = one.at_ns
        pieces[-1].append(one)
        end_ns += len(one.data) * CHARACTER_NS
    return [
        Sent(
            some[0].at_ns,
            bytes(
                byte
                for _, byte in sorted(
                    (
                        (one.at_ns + at * CHARACTER_NS, byte)
                        for one in some
                        for at, byte in enumerate(one.data)
                    ),
                    key=lambda one: one[0],
                )
            ),
        )
        for some in pieces
    ]


@pytest.mark.parametrize(("cycles", "begin"), [((500, 700), 0), ((1000, 1300), 2), ((200, 330), 1)])
def test_two_programs_that_share_a_port_are_two_masters(
    cycles: tuple[int, int], begin: float
) -> None:
    one = Plant(units=(1, 2), latency={1: 3, 2: 3}, cycle=cycles[0], timeout=300)
    other = Plant(
        units=(2, 1), latency={1: 3, 2: 3}, cycle=cycles[1], timeout=300, begin=begin, seed=2,
        quantity=6,
    )  # fmt: skip
    told = judged(mixed([*one.run(90), *other.run(90)]), EXACT)
    assert serious(told) == ["LINE-TWO-MASTERS"]


@every_timing
def test_of_two_masters_is_told_which_asks_what(timing: str) -> None:
    one = Plant(units=(1, 2), latency={1: 8, 2: 12}, cycle=1000)
    other = Plant(units=(2, 4), latency={2: 9, 4: 30}, cycle=700, begin=333, seed=2, quantity=6)
    told = worst(judged([*one.run(60), *other.run(60)], timing))
    assert told.cause.endswith(
        "one asks unit 2 (holding 32..37) and unit 4 every 700 ms, the other unit 1 and unit 2 "
        "(holding 32..35) every 1.00 s"
    )
    same = Plant(units=(3, 4), latency={3: 8, 4: 30}, cycle=1000, begin=5, seed=2)
    told = worst(judged([*one.run(60), *same.run(60)], timing))
    assert (told.code, "one asks" in told.cause) == ("LINE-TWO-MASTERS", False)


@every_timing
def test_one_master_with_two_lists_is_one_master(timing: str) -> None:
    slow = Plant(units=(1, 2), latency={1: 8, 2: 12}, cycle=1000).run(60)
    quick = Plant(units=(3,), latency={3: 9}, cycle=500, begin=250).run(60)
    assert serious(judged([*slow, *quick], timing)) == []


@dataclass(slots=True, kw_only=True)
class TwoSlaves(Plant):
    """A plant in which two slaves answer as unit 2."""

    other: float = 30

    def both(self, _: Plant, request: Sent, unit: int, pdu: bytes) -> list[Sent]:
        del pdu
        end_ns = request.end_ns(self.line)
        latencies = [self.latency[unit], *([self.other] if unit == 2 else [])]
        return sorted(
            (
                Sent(
                    end_ns + round(latency * self.random.uniform(0.9, 1.1) * MS),
                    rtu_adu(unit, values_pdu(self.random, self.quantity)),
                )
                for latency in latencies
            ),
            key=lambda one: one.at_ns,
        )


@every_timing
@pytest.mark.parametrize("other", [11, 30, 16])
def test_two_slaves_with_one_address_are_told(other: float, timing: str) -> None:
    plant = TwoSlaves(latency=QUICK, other=other)
    plant.respond = plant.both
    trouble = worst(judged(plant.run(60), timing))
    assert (trouble.code, trouble.unit) == ("LINE-SAME-UNIT", 2)


def stray(frames: Sequence[Sent], byte: int, *, ahead: bool, of: str) -> list[Sent]:
    def change(one: Sent) -> list[Sent]:
        if of != "all" and is_request(one) is not (of == "requests"):
            return [one]
        if ahead:
            return [Sent(one.at_ns - 2 * CHARACTER_NS, bytes([byte])), one]
        return [one, Sent(one.end_ns(LINE) + CHARACTER_NS // 2, bytes([byte]))]

    return each(frames, change)


@every_timing
@pytest.mark.parametrize("byte", [0x00, 0xFF, 0xF8])
@pytest.mark.parametrize(("ahead", "of"), [(True, "all"), (True, "answers"), (False, "answers")])
def test_a_constant_byte_beside_frames_is_missing_bias(
    byte: int, ahead: bool, of: str, timing: str
) -> None:
    trouble = worst(judged(stray(well(), byte, ahead=ahead, of=of), timing))
    assert trouble.code == "LINE-BIAS"
    assert f"a byte {byte:02X}H that nobody sends" in trouble.cause
    if timing == EXACT and of == "answers":
        assert f"{'before' if ahead else 'behind'} answers" in trouble.cause
        assert f"a slave's driver is switched {'on too early' if ahead else 'off too late'}" in (
            trouble.cause
        )
    if timing == EXACT and of == "all":
        assert trouble.cause.endswith("the idle line floats, as bias is missing")


def test_the_units_beside_whose_answers_a_constant_byte_stands_are_named() -> None:
    frames = [
        new
        for one in well()
        for new in (stray([one], 0, ahead=True, of="answers") if one.data[0] == 2 else [one])
    ]
    trouble = worst(judged(frames))
    assert trouble.code == "LINE-BIAS"
    assert "stands before answers of unit 2 (" in trouble.cause
    assert ": the driver of unit 2 is switched on too early" in trouble.cause
    assert trouble.remedy.startswith("look at how the driver of unit 2 is switched")


@every_timing
def test_the_echo_of_an_adapter_is_a_note(timing: str) -> None:
    def change(one: Sent) -> list[Sent]:
        copy = Sent(one.end_ns(LINE) + CHARACTER_NS // 2, one.data)
        return [one, copy] if is_request(one) else [one]

    told = judged(each(well(), change), timing)
    assert "LINE-ECHO" in [one.code for one in told.troubles]
    assert serious(told) == []


@every_timing
def test_frames_that_come_twice_are_told(timing: str) -> None:
    told = judged(
        each(well(), lambda one: [one, Sent(one.end_ns(LINE) + 3 * MS, one.data)]), timing
    )
    assert serious(told) == ["LINE-REPEATED"]


@every_timing
@pytest.mark.parametrize("side", ["requests", "responses"])
def test_one_side_of_a_line_is_told_and_blames_no_unit(side: str, timing: str) -> None:
    heard = [one for one in well() if is_request(one) is (side == "requests")]
    told = judged(heard, timing)
    assert serious(told) == ["LINE-ONE-SIDE"]
    assert f"only {side} are heard" in worst(told).cause


@every_timing
def test_a_dead_unit_is_not_one_side(timing: str) -> None:
    told = judged(Plant(latency={1: 8, 3: 20}).run(60), timing)
    assert serious(told) == ["UNIT-SILENT"]


@every_timing
def test_another_protocol_on_the_wires_is_told(timing: str) -> None:
    frames = well()
    text = b"~20014642E00201FD35\r"
    others = [Sent(frames[0].at_ns + (500 + 1000 * at) * MS, text) for at in range(59)]
    told = judged([*frames, *others], timing)
    assert serious(told) == ["LINE-FOREIGN"]
    assert "readable text" in worst(told).cause


def flipped(one: Sent, rate: float, random: Random) -> Sent:
    data = bytearray(one.data)
    for at in range(8 * len(data)):
        if random.random() < rate:
            data[at // 8] ^= 1 << at % 8
    return Sent(one.at_ns, bytes(data))


@every_timing
@pytest.mark.parametrize(
    ("where", "said"),
    [
        ("unit 3", "in the answers of unit 3"),
        ("requests", "in the master's requests"),
        ("all", "in requests and answers"),
    ],
)
def test_noise_is_told_with_where_it_sits(where: str, said: str, timing: str) -> None:
    random = Random(3)
    frames = [
        flipped(one, 4e-3, random)
        if where == "all"
        or (where == "requests" and is_request(one))
        or (where == "unit 3" and one.data[0] == 3 and not is_request(one))
        else one
        for one in well()
    ]
    told = judged(frames, timing)
    assert worst(told).code == "LINE-NOISE"
    assert said in worst(told).cause
    assert not any(one.severity is Severity.ERROR for one in told.troubles)


@every_timing
def test_a_single_damaged_frame_is_no_illness(timing: str) -> None:
    frames = well()
    frames[50] = flipped(frames[50], 0.05, Random(1))
    assert serious(judged(frames, timing)) in ([], ["RTU-202"], ["RTU-201"], ["MB-403"])


@every_timing
def test_lost_bytes_are_told(timing: str) -> None:
    random = Random(3)
    frames = [
        Sent(one.at_ns, bytes(byte for byte in one.data if random.random() > 0.02))
        for one in well()
    ]
    assert worst(judged(frames, timing)).code == "LINE-LOST-BYTES"


def heard_with(frames: Sequence[Sent], sent_as: SerialFormat) -> Iterator[Sent]:
    """What a listener at LINE gets of frames that are sent with other settings."""
    for one in frames:
        heard = [byte.value for byte in on_the_wire([one.data], sent_as).heard(LINE)]
        if heard:
            yield Sent(one.at_ns, bytes(heard))


@every_timing
@pytest.mark.parametrize("sent_as", [SerialFormat(9600), SerialFormat(38400)])
def test_wrong_settings_are_told_with_their_time(sent_as: SerialFormat, timing: str) -> None:
    frames = well()
    changed = [*frames[:120], *heard_with(frames[120:240], sent_as), *frames[240:]]
    trouble = worst(judged(changed, timing))
    assert trouble.code == "LINE-SETTINGS"
    assert trouble.since_ns is not None
    assert abs(trouble.since_ns - frames[120].at_ns) < 2_000_000_000
    assert trouble.until_ns is not None
    assert abs(trouble.until_ns - frames[240].at_ns) < 2_000_000_000
    whole = worst(judged([*heard_with(frames, sent_as)], timing))
    assert (whole.code, whole.since_ns) == ("LINE-SETTINGS", None)


def test_settings_are_not_wrong_where_polls_are_answered() -> None:
    random = Random(7)
    frames = well()
    noise = [
        Sent(frames[0].at_ns + (500 + 1000 * at) * MS, random.randbytes(40)) for at in range(59)
    ]
    assert "LINE-SETTINGS" not in serious(judged([*frames, *noise], FTDI))


def test_no_rule_doubts_the_settings_where_requests_are_answered() -> None:
    frames = well()
    text = b"~20014642E00201FD35\r" * 4
    others = [Sent(frames[0].at_ns + (300 + 1000 * at) * MS, text) for at in range(59)]
    lines = UnreadableLines(lambda _: None)
    for record in records_of([*frames, *others], EXACT):
        lines.note(record)
    assert list(lines.unreadable()) == []
