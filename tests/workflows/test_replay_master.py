"""A recording played as the master."""

from __future__ import annotations

import json
import re
import time
from fractions import Fraction
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING
from xml.etree import ElementTree

import msgspec
import pytest

from mbtool.core import InputError, UsageError, parse_link
from mbtool.core.limits import LinkLimits
from mbtool.master.links import MasterLink, ReceivedResponse
from mbtool.modbus import Outcome, Response
from mbtool.modbus.adu import Transport
from mbtool.replay import Control, TimeRange, Tolerance
from mbtool.slave.shells import open_shell
from mbtool.workflows import replay_master
from mbtool.workflows.replay_master import MasterOptions, MasterRun, Report, junit
from mbtool.workflows.shared.reading import ReadingOptions
from mbtool.workflows.shared.recorded import read_recorded
from tests.packets.building import pcap
from tests.slave.scripted import Scripted
from tests.views.junit_rules import demand_junit
from tests.workflows.evidence import READ, VALUES, WRITE, capture_file, capture_of, captured

if TYPE_CHECKING:
    from collections.abc import Callable

    from mbtool.devices import NamedTransaction
    from mbtool.replay import Progress, Step

LINE = Path(__file__).resolve().parents[2] / "captures" / "ft1a-touch-line.mcap"
OTHER_VALUES = bytes.fromhex("03 04 1234 0001")
SAME = "holding 0..1"


@pytest.fixture
def capture(tmp_path: Path) -> Path:
    path = tmp_path / "a.pcap"
    path.write_bytes(capture_file(3))
    return path


def _run(path: Path, **options: object) -> MasterRun:
    given = {"reading": ReadingOptions(), "rate": None, "timeout_ns": 20_000_000_000, **options}
    return MasterRun(str(path), MasterOptions(**given))  # type: ignore[arg-type]


def _transactions() -> list[NamedTransaction]:
    recorded = read_recorded(str(LINE.with_name("retry-after-silence.mcap")), MasterOptions())
    return [one for one in recorded.transactions if one.outcome is Outcome.OK]


def _report(
    run: MasterRun,
    script: Callable[[int, bytes], Response | None],
    **options: Callable[..., object],
) -> Report:
    with open_shell(parse_link("tcp:127.0.0.1:0"), Scripted(script)) as shell:
        return run.play(parse_link(shell.place), **options)  # type: ignore[arg-type]


def test_right_answers_make_no_difference(capture: Path) -> None:
    report = _report(_run(capture), lambda _, __: Response(VALUES))
    assert (report.requests, report.different, report.differences) == (3, 0, [])
    assert [(one.reference, one.count) for one in report.asked] == [(SAME, 3)]


def test_a_replay_that_the_user_ends_says_what_was_not_asked(capture: Path) -> None:
    answers: list[object] = []
    report = _report(
        _run(capture),
        lambda _, __: Response(VALUES),
        stops=lambda: bool(answers),
        on_answer=lambda *each: answers.append(each),
    )
    assert (report.requests, report.not_asked, report.not_awaited) == (1, 2, 0)
    assert json.loads(msgspec.json.encode(report))["not_asked"] == 2
    suite = ElementTree.fromstring(junit(report))
    demand_junit(suite)
    (error,) = suite.findall("testcase/error")
    assert error.get("message") == "interrupted after 1 of 3 requests"


def test_a_replay_that_ends_before_the_last_answer_says_so(capture: Path) -> None:
    asked: list[int] = []

    def answer(unit: int, _: bytes) -> Response | None:
        asked.append(unit)
        return Response(VALUES) if len(asked) < 3 else None

    report = _report(_run(capture), answer, stops=lambda: len(asked) == 3)
    assert (report.requests, report.not_asked, report.not_awaited) == (3, 0, 1)
    assert 'message="interrupted after 3 of 3 requests, 1 answer not awaited"' in junit(report)


def test_a_loop_that_was_played_once_is_not_interrupted(capture: Path) -> None:
    answers: list[object] = []
    report = _report(
        _run(capture, is_loop=True),
        lambda _, __: Response(VALUES),
        stops=lambda: len(answers) > 3,
        on_answer=lambda *each: answers.append(each),
    )
    assert (report.not_asked, report.not_awaited) == (0, 0)
    assert "interrupted" not in junit(report)


def test_wrong_answers_are_told_in_json_and_as_junit(capture: Path) -> None:
    report = _report(_run(capture), lambda _, __: Response(OTHER_VALUES))
    document = json.loads(msgspec.json.encode(report))
    assert document["different"] == 3
    assert document["differences"] == [
        {
            "kind": "value",
            "unit": 1,
            "reference": "holding 1",
            "what": "read",
            "a": {"text": "22136", "values": [22136]},
            "b": {"text": "1", "values": [1], "count": 3},
        }
    ]
    root = ElementTree.fromstring(junit(report))
    assert (root.get("tests"), root.get("failures")) == ("2", "2")
    failures = {case.get("name"): case.findtext("failure") for case in root}
    assert failures == {
        f"03 read {SAME}": "3 of 3 answers not as recorded; other values in holding 1",
        "value of holding 1": "recorded 22136, answered 1",
    }


def test_an_exception_fails_its_request_in_junit(capture: Path) -> None:
    report = _report(_run(capture), lambda _, pdu: Response(bytes([pdu[0] | 0x80, 2])))
    (case,) = ElementTree.fromstring(junit(report))
    assert (case.findtext("failure") or "").splitlines() == [
        "3 of 3 answers not as recorded",
        "recorded ok, answered exception 02 illegal data address",
    ]


def test_a_request_of_which_some_answers_differ_fails_in_junit(capture: Path) -> None:
    answers = iter((VALUES, OTHER_VALUES, VALUES))
    report = _report(_run(capture), lambda _, __: Response(next(answers)))
    failures = [case.findtext("failure") for case in ElementTree.fromstring(junit(report))]
    assert failures == [
        "1 of 3 answers not as recorded; other values in holding 1",
        "recorded 22136, answered 1 (1 of 3)",
    ]


def test_junit_has_what_ci_servers_need_of_every_case(tmp_path: Path) -> None:
    """Writes of several values and requests without registers have names of their own, too."""
    path = tmp_path / "a.pcap"
    requests = [
        READ,
        WRITE,
        WRITE[:-1] + b"\x08",
        b"\x07",
        b"\x11",
        b"\x08\0\0\0\1",
        b"\x08\0\0\0\2",
    ]
    path.write_bytes(capture_of([(pdu, VALUES if pdu == READ else pdu) for pdu in requests]))
    report = _report(
        _run(path), lambda _, pdu: Response(OTHER_VALUES if pdu == READ else b"\x86\x02")
    )
    suite = ElementTree.fromstring(junit(report))
    demand_junit(suite)
    assert sorted((case.get("classname"), case.get("name")) for case in suite) == [
        ("unit 1", "03 read holding 0..1"),
        ("unit 1", "06 write register holding 16"),
        ("unit 1", "07 read exc status 07"),
        ("unit 1", "08 diagnostics 08 00 00 00 01"),
        ("unit 1", "08 diagnostics 08 00 00 00 02"),
        ("unit 1", "11 report server id 11"),
        ("unit 1", "value of holding 1"),
    ]
    assert all(
        float(str(case.get("time"))) >= 0 for case in suite if "value" not in str(case.get("name"))
    )


def test_a_slave_that_cannot_be_reached_is_an_error_in_both_reports(capture: Path) -> None:
    report = _run(capture).play(parse_link("tcp:127.0.0.1:1"))
    assert (report.requests, report.differences) == (0, [])
    assert "does a slave listen there" in (report.problem or "")
    assert json.loads(msgspec.json.encode(report))["problem"] == report.problem
    suite = ElementTree.fromstring(junit(report))
    demand_junit(suite)
    (case,) = suite
    assert (case.get("classname"), case.get("name")) == ("link", "tcp:127.0.0.1:1")
    assert case.findtext("error") == report.problem


def test_silence_is_a_difference(capture: Path) -> None:
    report = _report(_run(capture, timeout_ns=20_000_000), lambda _, __: None)
    assert [(one.a.text, one.b.text, one.b.count) for one in report.differences] == [
        ("ok", "no answer", 3)
    ]


def test_a_slave_that_dies_is_not_waited_for(capture: Path) -> None:
    remarks: list[str] = []
    options = MasterOptions(reading=ReadingOptions(), rate=None, timeout_ns=600_000_000_000)
    run = MasterRun(str(capture), options, remarks.append)
    shell = open_shell(parse_link("tcp:127.0.0.1:0"), Scripted(lambda _, __: Response(VALUES)))
    told: list[tuple[bytes | None, bool]] = []

    def on_answer(_: Step, answer: bytes | None, is_right: bool) -> None:
        told.append((answer, is_right))
        shell.__exit__(None, None, None)

    report = run.play(parse_link(shell.__enter__().place), on_answer=on_answer)
    assert told == [(VALUES, True), (None, False), (None, False)]
    assert [one.b.text for one in report.differences] == [
        "no answer (2 of 3)",
        "opened, closed by the slave",
    ]
    assert len(remarks) == 1
    assert "the connection was lost; " in remarks[0]


def test_registers_can_be_ignored_or_learned(capture: Path) -> None:
    ignoring = _run(capture, ignore=["holding 1"])
    assert _report(ignoring, lambda _, __: Response(OTHER_VALUES)).different == 0
    learning = _run(capture, learns=True)
    report = _report(learning, lambda _, __: Response(OTHER_VALUES))
    assert (report.differences, report.learned) == ([], ["holding 1"])


def test_an_answer_that_is_damaged_in_the_recording_is_no_expectation(tmp_path: Path) -> None:
    torn = LINE.with_name("torn-and-glued-frames.mcap")  # One answer has a wrong CRC.
    report = _report(_run(torn), lambda _, __: Response(VALUES))
    assert (report.requests, report.different, report.damaged) == (8, 0, 1)
    malformed = tmp_path / "a.pcap"
    malformed.write_bytes(capture_of([(READ, VALUES), (READ, b"\x03\x03\x12\x34\x56")]))
    report = _report(_run(malformed), lambda _, __: Response(VALUES))
    assert (report.requests, report.different, report.damaged) == (2, 0, 1)


def test_an_answer_that_came_too_late_for_its_master_is_no_expectation() -> None:
    ours = [msgspec.structs.replace(one, outcome=Outcome.LATE) for one in _transactions()]
    (late, *rest), count = replay_master._without_damage([*ours[:1], *_transactions()[1:]], [])
    assert (late.outcome, late.response_raw, count) == (Outcome.NOT_CAPTURED, None, 1)
    assert [one.outcome for one in rest] == [Outcome.OK] * len(rest)


def test_silence_in_the_recording_stays_an_expectation() -> None:
    silent = LINE.with_name("retry-after-silence.mcap")
    report = _report(_run(silent, ignore=["holding 0"]), lambda _, __: Response(VALUES))
    assert (report.different, report.damaged) == (1, 0)


def test_another_unit_is_asked_than_the_recorded_one(capture: Path) -> None:
    asked: list[int] = []

    def answer(unit: int, _: bytes) -> Response:
        asked.append(unit)
        return Response(VALUES)

    report = _report(_run(capture, units={1: 9}), answer)
    assert (asked, report.different, [one.unit for one in report.asked]) == ([9] * 3, 0, [1])
    with pytest.raises(UsageError, match=r"--unit 7=1: .* asks unit 1"):
        _run(capture, units={7: 1})


def test_values_may_differ_by_what_is_tolerated(capture: Path) -> None:
    for text, different in (("holding 1=22135", 0), ("holding 1=22134", 3)):
        report = _report(_run(capture, tolerate=[text]), lambda _, __: Response(OTHER_VALUES))
        assert report.different == different


def test_late_answers_can_count(tmp_path: Path) -> None:
    path = tmp_path / "a.pcap"
    path.write_bytes(capture_file(8))
    run = _run(path, tolerance=Tolerance(share=0.0))
    report = _report(run, lambda _, __: Response(VALUES, 30_000_000))
    (found,) = report.differences
    assert (found.kind.value, report.uncompared_latencies) == ("latency", 0)
    (case,) = ElementTree.fromstring(junit(report))
    told = re.match(
        r"recorded 1 ms, p95 1 ms, answered (\d+) ms, p95", case.findtext("failure") or ""
    )
    assert told is not None
    assert int(told[1]) >= 30


def test_a_few_late_answers_do_not_count_and_that_is_said(capture: Path) -> None:
    run = _run(capture, tolerance=Tolerance(share=0.0))
    report = _report(run, lambda _, __: Response(VALUES, 30_000_000))
    assert (report.differences, report.uncompared_latencies) == ([], 1)


def test_recorded_times_are_kept(capture: Path) -> None:
    run = _run(capture, rate=Fraction(1))
    report = _report(run, lambda _, __: Response(VALUES))
    assert report.different == 0
    assert report.lateness_p99_ns is not None
    assert report.lateness_p99_ns >= 0


def test_each_answer_is_told_as_it_comes(capture: Path) -> None:
    told: list[tuple[int, bytes | None, bool]] = []

    def on_answer(step: Step, answer: bytes | None, is_right: bool) -> None:
        told.append((step.number, answer, is_right))

    _report(_run(capture), lambda _, __: Response(VALUES), on_answer=on_answer)
    assert told == [(number, VALUES, True) for number in range(3)]


def test_it_ends_when_it_is_told_to(capture: Path) -> None:
    assert _report(_run(capture), lambda _, __: None, stops=lambda: True).requests == 0


def test_only_what_is_wanted_is_asked() -> None:
    run = _run(LINE, wanted=lambda one: one.function == 4)
    assert {step.pdu[0] for step in run.script.steps} == {4}


def test_a_cut_recording_is_played_as_far_as_it_goes(tmp_path: Path) -> None:
    path = tmp_path / "a.pcap"
    path.write_bytes(pcap(captured(2))[:-1])
    remarks: list[str] = []
    run = MasterRun(str(path), MasterOptions(reading=ReadingOptions()), remarks.append)
    assert len(run.script.steps) == 2
    assert "playing what is there" in remarks[0]


def test_a_recording_without_a_request_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.pcap"
    path.write_bytes(capture_file(0))
    with pytest.raises(InputError, match="no request to ask"):
        _run(path)


def test_a_range_that_no_device_has_is_refused() -> None:
    with pytest.raises(UsageError, match="'RWr2' is no range"):
        _run(LINE, ignore=["RWr2"])


def test_what_was_asked_is_what_was_recorded(capture: Path) -> None:
    scripted = Scripted(lambda _, __: Response(VALUES))
    with open_shell(parse_link("tcp:127.0.0.1:0"), scripted) as shell:
        _run(capture).play(parse_link(shell.place))
    assert scripted.asked == [(1, READ)] * 3


class _Controls:
    """Someone who pauses at once, steps once, and then goes on."""

    def __init__(self) -> None:
        self.wanted = [Control.PAUSE, Control.STEP]
        self.shown: list[Progress] = []

    def controls(self) -> list[Control]:
        if not self.wanted and self.shown[-1].is_paused and "1 requests" in self.shown[-1].done:
            self.wanted.append(Control.PAUSE)
        return [self.wanted.pop(0)] if self.wanted else []

    def show(self, progress: Progress) -> None:
        self.shown.append(progress)


def test_it_is_paused_and_stepped_from_the_keyboard(capture: Path) -> None:
    controls = _Controls()
    report = _report(
        _run(capture, rate=Fraction(1)),
        lambda _, __: Response(VALUES),
        controls=controls,  # type: ignore[arg-type]
    )
    assert (report.requests, report.different) == (3, 0)
    assert any(one.is_paused and one.done.startswith("1 requests") for one in controls.shown)


def test_only_a_window_is_asked(capture: Path) -> None:
    whole = _run(capture).script
    later = whole.steps[1].position_ns - whole.steps[0].position_ns
    assert len(_run(capture, window=TimeRange(later)).script.steps) == 2
    with pytest.raises(InputError, match="to ask in the part from 99 s on; give another"):
        _run(capture, window=TimeRange(99_000_000_000))


class _SlowReader(MasterLink):
    """The response to each request is there as soon as somebody reads."""

    limits = LinkLimits(timeout_ns=2_000_000_000, one_at_a_time=False)
    transport = Transport.TCP

    def __init__(self) -> None:
        super().__init__()
        self._sent: list[int] = []

    def send(self, number: int, unit: int, pdu: bytes) -> None:
        self._sent.append(number)

    def receive(self, timeout_ns: int) -> list[ReceivedResponse]:
        numbers, self._sent = self._sent, []
        return [ReceivedResponse(number, VALUES, 0, 0) for number in numbers]

    def close(self) -> None: ...


def test_a_slave_is_not_blamed_if_this_process_did_not_run_for_a_while(
    capture: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ten_seconds = count(0, 10_000_000_000)  # Pass whenever somebody looks at the clock.
    monkeypatch.setattr(replay_master, "open_master", lambda *_: _SlowReader())
    monkeypatch.setattr(time, "monotonic_ns", lambda: next(ten_seconds))
    report = _run(capture, answers_only=True).play(parse_link("tcp:127.0.0.1:1"))
    assert (report.requests, report.different) == (3, 0)
