"""The silences of lines whose byte times are exact to 0.1 us, as a logic analyser gives them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from mbtool.core import SerialFormat
from mbtool.core.link_spec import parse_line
from mbtool.modbus import rtu_adu
from mbtool.workflows.check import CheckRun
from mbtool.workflows.shared.reading import ReadingOptions

if TYPE_CHECKING:
    from pathlib import Path

MS = 1e6
POLLS = (
    ("03 0000 0004", "03 08 0001 0002 0003 0004"),
    ("04 0010 0002", "04 04 1234 5678"),
)
SHARES = (0.01, 0.1, 0.5, 1.0)


class ByteTimes:
    """Polls of unit 2, some of them with a silence that is too short or too long, in ns."""

    def __init__(self, baud: int) -> None:
        self.format = SerialFormat(baud)
        self._character_ns = self.format.character_bits * 1e9 / baud
        self._now_ns = MS
        self._rows = ["t_start_s,t_end_s,line,byte_hex"]

    def poll(
        self,
        number: int,
        *,
        before_ns: float = 30 * MS,
        answer_ns: float = 9 * MS,
        inside_ns: float = 0,
        at: int = 3,
    ) -> None:
        request, answer = POLLS[number % 2]
        self._frame(request, before_ns, inside_ns, at)
        self._frame(answer, answer_ns, inside_ns, at)

    def write(self, folder: Path) -> Path:
        path = folder / "line.bytes.csv"
        path.write_text("\n".join(self._rows) + "\n")
        return path

    def _frame(self, pdu: str, before_ns: float, inside_ns: float, at: int) -> None:
        self._now_ns += before_ns
        for place, byte in enumerate(rtu_adu(2, bytes.fromhex(pdu))):
            self._now_ns += inside_ns if place == at else 0
            end_ns = self._now_ns + self._character_ns
            self._rows.append(f"{self._now_ns / 1e9:.7f},{end_ns / 1e9:.7f},tx,{byte:02X}")
            self._now_ns = end_ns


def polled(baud: int, share: float, **silence: float) -> ByteTimes:
    """A hundred polls; so large a share of them has a wrong silence, in characters."""
    line = ByteTimes(baud)
    character_ns = line.format.character_bits * 1e9 / baud
    wrong = {name: characters * character_ns for name, characters in silence.items()}
    for number in range(100):
        is_wrong = int((number + 1) * share + 1e-9) > int(number * share + 1e-9)
        line.poll(number, **(wrong if is_wrong else {}))  # type: ignore[arg-type]
    return line


def found(line: ByteTimes, folder: Path) -> list[tuple[str, int, str]]:
    options = ReadingOptions(line=parse_line(f"rtu@{line.format}"))
    run = CheckRun([str(line.write(folder))], options)
    findings = [placed.finding for placed in run.findings()]
    assert run.transactions == 100
    assert run.remarks == []
    return [(one.code, one.count, one.message) for one in findings]


def test_a_line_that_keeps_its_silences_has_no_finding(tmp_path: Path) -> None:
    assert found(polled(9600, 1.0, answer_ns=3.51, before_ns=3.51, inside_ns=1.49), tmp_path) == []


@pytest.mark.parametrize("share", SHARES)
@pytest.mark.parametrize("characters", [3.4, 3.0, 2.5, 2.0, 1.6, 1.0, 0.5, 0.0])
def test_a_slave_that_answers_too_soon_is_found_at_every_share(
    characters: float, share: float, tmp_path: Path
) -> None:
    ((code, count, message),) = found(polled(9600, share, answer_ns=characters), tmp_path)
    assert (code, count) == ("RTU-103", round(100 * share))
    assert message.startswith(
        f"unit 2 answers too soon in {count} of the unit's 100 transactions, the soonest"
    )
    assert f"after {characters:.1f} characters, " in message


@pytest.mark.parametrize("share", SHARES)
@pytest.mark.parametrize("characters", [3.4, 2.0, 0.5, 0.0])
def test_a_master_that_asks_too_soon_is_found_at_every_share(
    characters: float, share: float, tmp_path: Path
) -> None:
    ((code, count, message),) = found(polled(9600, share, before_ns=characters), tmp_path)
    # Nothing comes before the first request.
    assert (code, count) == ("RTU-103", 99 if share == 1.0 else round(100 * share))
    assert message.startswith("the master asks unit 2 too soon in ")
    assert f"after {characters:.1f} characters, " in message


def test_who_is_hasty_is_said_of_each_side(tmp_path: Path) -> None:
    findings = found(polled(9600, 1.0, answer_ns=1.0, before_ns=2.0), tmp_path)
    assert [(code, count) for code, count, _ in findings] == [("RTU-103", 100), ("RTU-103", 99)]


@pytest.mark.parametrize("share", SHARES)
@pytest.mark.parametrize("at", [1, 2, 3, 5, 7])
@pytest.mark.parametrize("baud", [9600, 19200, 115200])
def test_a_sender_that_tears_its_frames_is_found_at_every_share(
    baud: int, at: int, share: float, tmp_path: Path
) -> None:
    characters = 4.2 if baud <= 19200 else 1.2 * 1.75e-3 * baud / 11
    line = ByteTimes(baud)
    inside_ns = characters * line.format.character_ns
    for number in range(100):
        is_wrong = int((number + 1) * share + 1e-9) > int(number * share + 1e-9)
        line.poll(number, inside_ns=inside_ns if is_wrong else 0, at=at)
    assert [(code, count) for code, count, _ in found(line, tmp_path)] == [
        ("RTU-102", round(100 * share))
    ]


@pytest.mark.parametrize("share", SHARES)
@pytest.mark.parametrize("characters", [1.6, 3.4])
def test_a_silence_beyond_t1_5_inside_frames_is_found_at_every_share(
    characters: float, share: float, tmp_path: Path
) -> None:
    ((code, count, _),) = found(polled(19200, share, inside_ns=characters), tmp_path)
    assert (code, count) == ("RTU-101", round(100 * share))


def test_above_19200_baud_the_finding_says_which_rule_is_broken(tmp_path: Path) -> None:
    half_a_ms = 5.2
    ((_, _, message),) = found(polled(115200, 1.0, answer_ns=half_a_ms), tmp_path)
    assert message.endswith(
        "after 5.2 characters, 0.50 ms; above 19200 baud the standard fixes t3.5 at 1.75 ms; "
        "3.5 characters, the rule of some manuals, are kept"
    )
    ((_, _, message),) = found(polled(115200, 1.0, answer_ns=2.0), tmp_path)
    assert message.endswith("0.19 ms; above 19200 baud the standard fixes t3.5 at 1.75 ms")


def test_times_that_a_program_made_are_not_exact(tmp_path: Path) -> None:
    line = polled(9600, 1.0, answer_ns=0.0)
    rows = line.write(tmp_path).read_text().splitlines()
    # All bytes of a poll are noted when they are read, in one go.
    size = 8 + 13 + 8 + 9
    for begin in range(1, len(rows), size):
        first = rows[begin].split(",")[0]
        for at in range(begin, min(begin + size, len(rows))):
            rows[at] = f"{first},{first},tx,{rows[at][-2:]}"
    path = tmp_path / "noted.bytes.csv"
    path.write_text("\n".join(rows) + "\n")
    run = CheckRun([str(path)], ReadingOptions(line=parse_line("rtu@9600-8E1")))
    assert [placed.finding.code for placed in run.findings()] == ["RTU-104"]
