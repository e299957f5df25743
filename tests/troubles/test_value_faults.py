"""What numbers in registers do by themselves, and what they do not."""

from __future__ import annotations

import random
from array import array
from typing import TYPE_CHECKING

import pytest

from mbtool.devices import Assignment, Assignments, Who, load_profile
from mbtool.ledger.account import Account
from mbtool.ledger.answered_reads import AnsweredReads
from mbtool.modbus.tables import Table
from mbtool.troubles.judge import Judge
from mbtool.troubles.value_faults import MAX_WRITTEN, ValueFaults
from mbtool.values.followed_values import judged_values
from mbtool.values.judging import WordHistory
from mbtool.values.movements import Movements
from mbtool.workflows.check import CheckRun
from mbtool.workflows.shared.reading import Reading, ReadingOptions
from tests.adversary.illnesses.wire import SECOND
from tests.adversary.values.faults import HEAD, Read, told
from tests.ledger.requests import request
from tests.packets.building import Talk, pcap

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    from mbtool.devices import NamedTransaction
    from mbtool.ledger.answered_reads import ValueChanges

ROWS = 240


def noise(seed: int, middle: int = 5000, width: int = 20) -> list[int]:
    rng = random.Random(seed)
    return [middle + rng.randint(-width, width) for _ in range(ROWS)]


def slow(seed: int, begin: int = 2000) -> list[int]:
    rng = random.Random(seed)
    found = [begin]
    while len(found) < ROWS:
        found.append(found[-1] + rng.choice((0, 1, 1, 2)) * (1 if len(found) < 160 else -1))
    return found


def counter(begin: int, step: int = 3) -> list[int]:
    return [begin + at * step for at in range(ROWS)]


def codes(
    columns: Sequence[Sequence[int]], folder: Path, profile: str = "", address: int = 10
) -> list[tuple[str, str]]:
    """The code of each trouble, and its first case."""
    reads = [
        Read(at * SECOND, 1, 3, address, [word & 0xFFFF for word in row])
        for at, row in enumerate(zip(*columns, strict=True))
    ]
    return [(one["code"], one["evidence"][0]["text"]) for one in told(reads, folder, 1, profile)]


def point(**keys: object) -> str:
    lines = {"name": '"Flow"', "table": '"holding_registers"', "address": 10, **keys}
    return f"{HEAD}[[points]]\n" + "".join(f"{key} = {one}\n" for key, one in lines.items())


def test_numbers_that_move_as_ever_are_well(tmp_path: Path) -> None:
    assert codes([noise(1), slow(2), counter(7), [0] * ROWS, noise(3, 0, 2)], tmp_path) == []


def test_a_number_that_stays_while_others_move_is_stuck(tmp_path: Path) -> None:
    frozen = noise(1)
    frozen[150:] = [5003] * 90
    assert codes([frozen, noise(2)], tmp_path) == [("VALUE-STUCK", "holding 10: 5003")]
    assert codes([frozen[:150] + [0] * 90, noise(2)], tmp_path) == []
    others = noise(2)
    others[150:] = [5003] * 90
    assert codes([frozen, others], tmp_path) == []


def test_a_number_that_is_far_away_once_has_jumped(tmp_path: Path) -> None:
    jumped = noise(1)
    jumped[150] = 9000
    assert [code for code, _ in codes([jumped, noise(2)], tmp_path)] == ["VALUE-JUMPED"]
    beside = noise(2)
    beside[150] = 9100
    assert codes([jumped, beside], tmp_path) == []
    often = [9000 if at % 40 == 7 else number for at, number in enumerate(noise(1))]
    assert codes([often, noise(2)], tmp_path) == []


def test_a_slow_number_that_goes_on_elsewhere_has_jumped(tmp_path: Path) -> None:
    jumped = slow(1)
    jumped[170:] = [number + 700 for number in jumped[170:]]
    assert [code for code, _ in codes([jumped, noise(2)], tmp_path)] == ["VALUE-JUMPED"]
    switched = noise(1)
    switched[170:] = [number + 3000 for number in switched[170:]]
    assert codes([switched, noise(2)], tmp_path) == []


@pytest.mark.parametrize(
    ("numbers", "code"),
    [
        (counter(7000), None),
        (counter(7000)[:140] + counter(0)[:100], "VALUE-RESET"),
        (counter(7000)[:140] + counter(6900)[:100], "VALUE-BACKWARDS"),
        ([number % 65536 for number in counter(65200)], None),
        ([number % 10000 for number in counter(9700)], None),
        ([number % 60 for number in counter(0, 1)][:60] + counter(0, 1)[:180], None),
    ],
)
def test_a_counter_that_falls_was_reset_or_runs_backwards(
    tmp_path: Path, numbers: list[int], code: str | None
) -> None:
    found = codes([numbers, noise(2)], tmp_path)
    assert [each for each, _ in found] == ([] if code is None else [code])


def test_a_word_that_stands_for_no_value_is_told_unless_the_profile_knows_it(
    tmp_path: Path,
) -> None:
    lacking = noise(1, 515, 6)
    lacking[150:153] = [0xFFFF] * 3
    assert [code for code, _ in codes([lacking, noise(2)], tmp_path)] == ["VALUE-NONE"]
    assert codes([lacking, noise(2)], tmp_path, point(no_value=0xFFFF)) == []
    assert codes([noise(1, 2, 3), noise(2)], tmp_path) == [], "-1 is a number beside 0 and 1"
    fallen = [(number - 500) % 65536 for number in noise(1, 512, 4)]
    fallen[150] = 0xFFFF
    assert codes([fallen, noise(2)], tmp_path) == [], "a number near 0 may fall to -1 once"


def test_nan_among_floats_is_no_value(tmp_path: Path) -> None:
    words = [0x41B8 + number % 8 for number in noise(1)]
    words[150] = 0x7FC0
    found = codes([words, [0] * ROWS, noise(2)], tmp_path, point(type='"float32"'))
    assert found == [("VALUE-NONE", "Flow: NaN")]


def test_a_number_outside_of_its_profile_is_told_with_scale_and_unit(tmp_path: Path) -> None:
    high = noise(1, 515, 6)
    high[150:153] = [900] * 3
    profile = point(scale=0.1, unit='"degC"', maximum=60)
    assert codes([high, noise(2)], tmp_path, profile) == [("VALUE-RANGE", "Flow: 90 degC")]
    assert codes([high, noise(2)], tmp_path, point(scale=0.1, maximum=91)) != []
    assert codes([noise(1, 515, 6), noise(2)], tmp_path, profile) == []


@pytest.mark.parametrize(
    ("key", "good", "bad"),
    [
        ('bits = { 2 = "sensor fault" }', 1, 5),
        ('bits = { 2 = "value valid" }', 5, 1),
        ('texts = { 0 = "ok", 7 = "not valid" }', 0, 7),
    ],
)
def test_a_state_that_says_not_valid_is_told(tmp_path: Path, key: str, good: int, bad: int) -> None:
    name, _, text = key.partition(" = ")
    kind = '"flags"' if name == "bits" else '"uint16"'
    profile = point(type=kind, **{name: text})
    states = [good] * 150 + [bad] * 90
    assert [code for code, _ in codes([states, noise(2)], tmp_path, profile)] == ["VALUE-NOT-VALID"]
    assert codes([[good] * ROWS, noise(2)], tmp_path, profile) == []


def test_a_register_that_a_master_writes_is_set(tmp_path: Path) -> None:
    numbers = noise(1)
    numbers[150] = 9000
    judge = Judge(Account(lambda _: None))
    path = tmp_path / "a.pcap"
    for is_written in (False, True):
        path.write_bytes(captured([numbers, noise(2)], is_written=is_written))
        judge = Judge(Account(lambda _: None))
        for record in Reading([str(path)], ReadingOptions()).records():
            judge.count(record)
        found = [one.code for one in judge.judgement().troubles if one.code.startswith("VALUE")]
        assert found == ([] if is_written else ["VALUE-JUMPED"])


def captured(
    columns: Sequence[Sequence[int]], *, is_written: bool = False, begin_s: int = 0
) -> bytes:
    """A capture of a connection, in which a master reads registers (and writes one)."""
    talk = Talk()
    talk.ts_ns += begin_s * SECOND
    packets = talk.handshake()
    for number, row in enumerate(zip(*columns, strict=True)):
        words = b"".join(word.to_bytes(2) for word in row)
        pairs = [(b"\3\0\x0a" + len(row).to_bytes(2), bytes([3, len(words)]) + words)]
        if is_written and number == 200:
            pairs.append((b"\6\0\x0a\0\1", b"\6\0\x0a\0\1"))
        for asked, response in pairs:
            packets.append(talk.request(_adu(number, asked)))
            packets.append(talk.response(_adu(number, response)))
        talk.ts_ns += SECOND
    return pcap(packets)


def _adu(number: int, pdu: bytes) -> bytes:
    return number.to_bytes(2) + b"\0\0" + (len(pdu) + 1).to_bytes(2) + b"\1" + pdu


def test_arrays_and_single_records_give_the_same_troubles(tmp_path: Path) -> None:
    rows = 2400
    columns = [
        [number + 3 * (at % 7) for at, number in enumerate(noise(seed) * (rows // ROWS))]
        for seed in range(6)
    ]
    columns[2][1500] = 9000
    columns[3][1200:] = [5001] * (rows - 1200)
    path = tmp_path / "a.pcap"
    path.write_bytes(captured(columns))
    run = CheckRun([str(path)], ReadingOptions())
    assert any(one.rows is not None for one in run.checked()), "nothing was read as arrays"
    judge = Judge(Account(lambda _: None))
    for record in Reading([str(path)], ReadingOptions()).records():
        judge.count(record)
    found = [one.sentence for one in judge.judgement().troubles]
    assert [one.sentence for one in run.judgement().troubles] == found
    assert {one.code for one in judge.judgement().troubles} == {"VALUE-JUMPED", "VALUE-STUCK"}


def checked(
    folder: Path,
    good: Sequence[Sequence[int]],
    now: Sequence[Sequence[int]],
    assignments: Assignments | None = None,
) -> list[str]:
    """The codes of what is told of a capture, without a baseline and with one."""
    before, after = folder / "good.pcap", folder / "now.pcap"
    before.write_bytes(captured(good))
    after.write_bytes(captured(now, begin_s=100_000))
    told = []
    for baseline in ([], [str(before)]):
        run = CheckRun([str(after)], ReadingOptions(assignments=assignments or Assignments()))
        if baseline:
            assert run.learn(baseline) == []
        list(run.findings())
        codes = [one.code for one in run.judgement().troubles if one.code.startswith("VALUE")]
        told.append(" ".join(codes))
    return told


def test_a_number_that_moved_in_the_baseline_is_stuck_from_the_beginning(tmp_path: Path) -> None:
    now = [[5003] * ROWS, noise(3)]
    assert checked(tmp_path, [noise(1), noise(2)], now) == ["", "VALUE-STUCK"]


def test_a_short_capture_is_judged_by_the_baseline(tmp_path: Path) -> None:
    now = [noise(3)[:30], noise(4)[:30]]
    now[0][20] = 9000
    assert checked(tmp_path, [noise(1), noise(2)], now) == ["", "VALUE-JUMPED"]


def test_what_happened_in_the_baseline_is_usual_and_not_told_again(tmp_path: Path) -> None:
    good, now = noise(1), noise(3)
    good[100] = good[180] = now[150] = 9000
    assert checked(tmp_path, [good, noise(2)], [now, noise(4)]) == ["VALUE-JUMPED", ""]
    assert checked(tmp_path, [good, noise(2)], [noise(3), noise(4)]) == ["", ""]


def test_a_counter_may_stand_elsewhere_than_in_the_baseline(tmp_path: Path) -> None:
    now = [counter(10), noise(4)]
    assert checked(tmp_path, [counter(7000), noise(2)], now) == ["", ""]


def read(at: int, link: str, *values: int) -> NamedTransaction:
    at_ns = at * SECOND
    return request(link=link, request_ns=at_ns, quantity=len(values), response_values=list(values),
                   response_ns=at_ns + 1000)  # fmt: skip


def judged(norms: dict[str, int], checked: dict[str, Sequence[int]], begin: int) -> ValueFaults:
    """Judge lines by the lines of a baseline; numbers are seeds. Each line has two registers, and
    the second one is noise.
    """
    norm = ValueFaults(Assignments())
    norm.become_norm()
    for link, seed in norms.items():
        for at, pair in enumerate(zip(noise(seed), noise(seed + 1), strict=True)):
            norm.transaction(read(at, link, *pair))
    sense = ValueFaults(Assignments())
    sense.judge_by(norm)
    for link, numbers in checked.items():
        for at, pair in enumerate(zip(numbers, noise(9), strict=True)):
            sense.transaction(read(begin + at, link, *pair))
    return sense


FROZEN = [5003] * ROWS


def test_each_line_is_compared_with_the_line_of_the_baseline_that_has_its_requests() -> None:
    def stuck(norms: dict[str, int], checked: dict[str, Sequence[int]]) -> set[str]:
        return {one.link for one in judged(norms, checked, 100_000).troubles(())}

    assert stuck({"good.csv": 1}, {"now.csv": FROZEN}) == {"now.csv"}
    assert stuck({"good.csv": 1, "more.csv": 3}, {"now.csv": FROZEN}) == {"now.csv"}
    assert stuck({"good.csv": 1}, {"a": FROZEN, "b": FROZEN}) == {"a", "b"}
    assert stuck({"good.csv": 1}, {"b": FROZEN, "a": FROZEN}) == {"a", "b"}


def test_a_baseline_with_the_times_of_the_capture_is_not_used_and_that_is_said() -> None:
    jumped = [*noise(3)]
    jumped[150] = 9000
    sense = judged({"good.csv": 1}, {"now.csv": jumped}, begin=0)
    assert [one.code for one in sense.troubles(())] == ["VALUE-JUMPED"]
    assert "have the same times" in (sense.norm_remark or "")
    assert judged({"good.csv": 1}, {"now.csv": jumped}, begin=100_000).norm_remark is None


def test_a_baseline_without_the_requests_of_the_capture_is_said_to_be_unused() -> None:
    norm = ValueFaults(Assignments())
    norm.become_norm()
    sense = ValueFaults(Assignments())
    sense.judge_by(norm)
    sense.transaction(read(0, "a", 1, 2))
    assert "no request of the baseline" in (sense.norm_remark or "")


def test_a_register_that_rests_at_the_end_of_the_baseline_is_well(tmp_path: Path) -> None:
    good = noise(1)
    good[-60:] = [4986] * 60
    assert checked(tmp_path, [good, noise(2)], [noise(3), noise(4)]) == ["", ""]


def test_what_was_outside_of_its_range_in_the_baseline_only_is_not_told(tmp_path: Path) -> None:
    (tmp_path / "own.toml").write_text(point(scale=0.1, maximum=60))
    profile = Assignments([Assignment(Who(), load_profile(str(tmp_path / "own.toml")))])
    good, bad = [noise(1, 515, 6), noise(2)], [noise(1, 515, 6), noise(2)]
    good[0][150] = bad[0][100] = bad[0][120] = 900
    assert checked(tmp_path, good, [noise(3, 515, 6), noise(2)], profile) == ["", ""]
    assert checked(tmp_path, good, bad, profile) == ["VALUE-RANGE", "VALUE-RANGE"]


class Words:
    """The values of reads, as AnsweredReads has them."""

    def __init__(self, rows: Sequence[Sequence[int]]) -> None:
        self._rows = rows

    def words(self) -> bytes:
        return array("H", [word for row in self._rows for word in row]).tobytes()

    def last(self) -> list[int]:
        raise NotImplementedError

    def changes(
        self, before: Sequence[int] | None, place: int, *, every: bool = False
    ) -> ValueChanges:
        raise NotImplementedError


class Reads:
    """The reads of one poll, as AnsweredValues has them."""

    def __init__(self, quantity: int, times: list[int], rows: Sequence[Sequence[int]]) -> None:
        self.asked = [("a", 1, 3, 10, quantity)]
        self._reads = [AnsweredReads(times, Words(rows))]

    def __getitem__(self, index: int) -> AnsweredReads:
        return self._reads[index]


def test_the_portions_in_which_answers_come_do_not_matter() -> None:
    frozen, jumped = noise(1), noise(2)
    frozen[120:] = [5003] * 120
    jumped[150] = 9000
    rows = [*zip(frozen, jumped, counter(9000), noise(4), strict=True)]

    def sentences(cuts: Sequence[int], ask: Callable[[ValueFaults], object]) -> list[str]:
        sense = ValueFaults(Assignments())
        for begin, end in zip((0, *cuts), (*cuts, ROWS), strict=True):
            times = [at * SECOND for at in range(begin, end)]
            sense.reads(Reads(4, times, rows[begin:end]))
            ask(sense)
        return [one.sentence for one in sense.troubles(())]

    whole = sentences([], lambda _: None)
    assert len(whole) == 2
    rng = random.Random(7)
    for _ in range(10):
        cuts = sorted(rng.sample(range(1, ROWS), 6))
        assert sentences(cuts, lambda _: None) == whole
        assert sentences(cuts, lambda sense: list(sense.troubles(()))) == whole


def test_very_many_equal_answers_at_once_are_passed_over() -> None:
    rows = [(5003,)] * 250_000
    sense = ValueFaults(Assignments())
    sense.reads(Reads(1, [*range(len(rows))], rows))
    assert [*sense.troubles(())] == []


def test_figures_of_movements_do_not_depend_on_portions() -> None:
    standing = [700] * ROWS
    standing[90:95], standing[150], standing[170:] = [0xFFFF] * 5, 701, [900] * 70
    columns = (noise(1), slow(2), [number & 0xFFFF for number in counter(65000)], standing)
    rows = [*zip(*columns, strict=True)]
    times = [at * SECOND + (900 * SECOND) * (at > 130) for at in range(ROWS)]
    values = judged_values(WordHistory(Table.HOLDING_REGISTERS, 0, times[:64], rows[:64]))

    def figures(cuts: Sequence[int]) -> list[object]:
        one = Movements(values, SECOND)
        for begin, end in zip((0, *cuts), (*cuts, ROWS), strict=True):
            words = array("H", [word for row in rows[begin:end] for word in row])
            one.add(times[begin:end], words.tobytes())
        return [
            (one.rows, one.moves, one.changes.tolist(), one.rises.tolist(), one.low.tolist()),
            *(
                (one.rests(at), [each.size for each in one.steps(at)], one.falls(at), one.unset(at))
                for at in range(len(values))
            ),
        ]

    whole = figures([])
    rng = random.Random(3)
    for _ in range(20):
        assert figures(sorted(rng.sample(range(1, ROWS), 5))) == whole


def test_nothing_is_told_of_a_unit_with_more_written_registers_than_are_remembered() -> None:
    faults = ValueFaults(Assignments())
    for address in range(MAX_WRITTEN + 1):
        faults._note_write("line", 1, Table.HOLDING_REGISTERS, range(address, address + 1))
    assert faults._much_written == {("line", 1)}
