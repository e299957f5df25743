"""A slave that does as its profile says passes, and each deviation is named."""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import replace
from itertools import count
from typing import TYPE_CHECKING

import pytest

from mbtool.core import Endpoint, SerialFormat, SerialLink, TcpLink, parse_link
from mbtool.devices import builtin_profiles, load_profile, parse_span
from mbtool.master.wire import open_wire
from mbtool.modbus.adu import Transport
from mbtool.sources.virtual_line import VirtualLine
from mbtool.workflows.ask import transport_of
from mbtool.workflows.conformance import Conformance, Result
from mbtool.workflows.slave import device_slave
from tests.workflows.slave_in_memory import SlaveInMemory, TimelessSlave

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

    from mbtool.core import LinkSpec
    from mbtool.workflows.conformance import CaseResult

FAST = SerialFormat(baud=115200, parity="N")
UNIT = 5
TOUCH = "idec-ft1a-touch"
COUPLER = "wago-750"
# A slave may close the connection before the next request is sent, or after that.
WRONG_CRC, CLOSED = "got a wrong CRC: ", "the connection"
FAULTS: tuple[tuple[str, str, str], ...] = (
    ("rtu", "kind = 'no-answer'", "expected 1 value, got no answer"),
    ("rtu", "kind = 'no-answer', functions = [3]", "expected 1 value, got no answer"),
    ("rtu", "kind = 'no-answer', every = 5", "got no answer"),
    ("rtu", "kind = 'no-answer', nth = 20, times = 1", "got no answer"),
    ("rtu", "kind = 'exception', functions = [3]", "got exception 04 server device failure"),
    ("rtu", "kind = 'exception', code = 3", "got exception 03 illegal data value"),
    ("rtu", "kind = 'exception', code = 6, every = 7", "got exception 06 server device busy"),
    ("rtu", "kind = 'exception', registers = 'holding 9'", "got exception 04"),
    ("rtu", "kind = 'wrong-unit'", "expected unit 5 in the answer, got unit 6"),
    ("rtu", "kind = 'wrong-unit', by = 3, functions = [1]", "in the answer, got unit 8"),
    ("rtu", "kind = 'truncated'", "got 5 bytes, where the answer has 6"),
    ("rtu", "kind = 'truncated', bytes = 2", "got 4 bytes, where the answer has 6"),
    (
        "rtu",
        "kind = 'truncated', bytes = 4, functions = [3]",
        "got 3 bytes, where the answer has 7",
    ),
    ("rtu", "kind = 'extra-bytes'", "got 1 byte of values and 1 byte behind them"),
    ("rtu", "kind = 'extra-bytes', bytes = 'ff00'", "got ff 00 behind the answer"),
    ("rtu", "kind = 'bad-crc'", WRONG_CRC),
    ("rtu", "kind = 'bad-crc', every = 9", WRONG_CRC),
    ("rtu", "kind = 'bad-crc', functions = [2]", WRONG_CRC),
    ("rtu", "kind = 'split', gap_ms = 400", "the answer pauses "),
    ("rtu", "kind = 'split', pieces = 3, gap_ms = 300, functions = [3]", "the answer pauses "),
    ("rtu", "kind = 'delay', ms = 4000", "got the answer only after "),
    ("rtu", "kind = 'delay', ms = 4000, every = 11", "got the answer only after "),
    ("ascii", "kind = 'bad-crc'", "got a wrong LRC: f6, right is f9"),
    ("ascii", "kind = 'truncated'", "got a frame without its end, CR LF"),
    ("ascii", "kind = 'extra-bytes', bytes = '3a'", "expected nothing behind the answer, got 3a"),
    ("ascii", "kind = 'wrong-unit'", "expected unit 5 in the answer, got unit 6"),
    ("ascii", "kind = 'no-answer', functions = [3]", "expected 1 value, got no answer"),
    ("tcp", "kind = 'no-answer'", "expected 1 value, got no answer"),
    ("tcp", "kind = 'no-answer', functions = [3]", "got no answer"),
    ("tcp", "kind = 'no-answer', every = 5", "got no answer"),
    ("tcp", "kind = 'exception', every = 4", "got exception 04 server device failure"),
    ("tcp", "kind = 'wrong-unit'", "expected unit 5 in the answer, got unit 6"),
    ("tcp", "kind = 'wrong-id'", "expected transaction id 0001 in the answer, got 0002"),
    ("tcp", "kind = 'wrong-id', by = 256, every = 3", "in the answer, got 0101"),
    ("tcp", "kind = 'truncated'", "got 9 bytes of an ADU of 10: "),
    ("tcp", "kind = 'truncated', bytes = 3, every = 6", "got 7 bytes of an ADU of 10: "),
    ("tcp", "kind = 'extra-bytes'", "expected nothing behind the answer, got 00"),
    ("tcp", "kind = 'close'", CLOSED),
    ("tcp", "kind = 'close', every = 10", CLOSED),
    ("tcp", "kind = 'reset'", CLOSED),
    ("tcp", "kind = 'delay', ms = 4000", "got the answer only after "),
    ("rtu+tcp", "kind = 'bad-crc'", WRONG_CRC),
    ("rtu+tcp", "kind = 'truncated'", "got 5 bytes, where the answer has 6"),
    ("rtu+tcp", "kind = 'extra-bytes'", "got 1 byte of values and 1 byte behind them"),
)
"""Each fault of `slave --fault` on a link, and how the first case that fails tells it."""
REAL = {
    ("rtu", "kind = 'bad-crc'"),
    ("ascii", "kind = 'extra-bytes', bytes = '3a'"),
    ("tcp", "kind = 'close'"),
    ("tcp", "kind = 'reset'"),
    ("rtu+tcp", "kind = 'extra-bytes'"),
}
"""Those that are tried on a serial line and a connection, too: one of each way to send a fault."""


def of_transport(name: str, transport: Transport) -> bool:
    return transport in load_profile(name).transports


@pytest.fixture
def stack() -> Iterator[ExitStack]:
    with ExitStack() as opened:
        yield opened


def results(
    stack: ExitStack,
    name: str,
    *,
    transport: str,
    fault: str | None = None,
    writes: tuple[str, ...] = (),
    folder: Path | None = None,
    until: str | None = None,
    patch: pytest.MonkeyPatch | None = None,
) -> list[CaseResult]:
    """The results of the embedded slave with a fault, up to the first one that tells `until`.

    With `patch` the slave has a clock of its own.
    """
    profile = load_profile(name)
    timeout_s = 1 if "delay" in (fault or "") else 30
    faults = None
    if fault is not None:
        assert folder is not None
        faults = folder / "fault.toml"
        faults.write_text(f"faults = [{{ {fault} }}]")
    link: LinkSpec
    if transport in ("rtu", "ascii"):
        link = SerialLink("/dev/line", FAST, ascii=transport == "ascii")
    else:
        link = TcpLink(Endpoint("127.0.0.1", 0), rtu=transport == "rtu+tcp")
    if patch is not None:
        TimelessSlave(patch, profile, link, UNIT, faults)
    elif isinstance(link, SerialLink):
        line = stack.enter_context(VirtualLine(ends=2, format=FAST))
        theirs, link = (replace(link, port=port) for port in line.ports)
        stack.enter_context(device_slave(profile, theirs, UNIT, fault_file=faults))
    else:
        slave = stack.enter_context(device_slave(profile, link, UNIT, fault_file=faults))
        link = parse_link(slave.place, "the slave")
    known = profile.with_limits_of(transport_of(link))
    spans = [parse_span(text, [known]) for text in writes]
    with open_wire(link, timeout_s * 1_000_000_000, 0) as wire:
        work = Conformance(known, link, wire, UNIT)
        cases = work.report.cases
        return list(work.run(spans, lambda: until is not None and until in cases[-1].problem))


def test_the_embedded_slave_passes_with_rtu_over_tcp(stack: ExitStack) -> None:
    profile = load_profile(TOUCH)
    slave = stack.enter_context(
        device_slave(profile, TcpLink(Endpoint("127.0.0.1", 0), rtu=True), UNIT)
    )
    link = parse_link(slave.place, "the slave")
    with open_wire(link, 3_000_000_000, 0) as wire:
        known = profile.with_limits_of(Transport.RTU_TCP)
        cases = list(Conformance(known, link, wire, UNIT).run())
    assert len(cases) > 40
    assert failed(cases) == []


def failed(cases: list[CaseResult]) -> list[str]:
    return [f"{one.name}: {one.problem}" for one in cases if one.result is Result.FAILED]


def noted(cases: list[CaseResult]) -> list[str]:
    return [f"{one.name}: {one.problem}" for one in cases if one.result is Result.NOTE]


@pytest.mark.parametrize("name", ["fa3-at1m8x", COUPLER])
def test_the_embedded_slave_of_a_profile_passes_on_tcp(stack: ExitStack, name: str) -> None:
    cases = results(stack, name, transport="tcp")
    assert len(cases) > 40
    assert failed(cases) == []


@pytest.mark.parametrize(
    ("transport", "name"),
    [
        (transport.value, name)
        for transport in (Transport.TCP, Transport.RTU, Transport.ASCII)
        for name in builtin_profiles()
        if of_transport(name, transport)
    ],
)
def test_the_embedded_slave_of_a_profile_passes(
    stack: ExitStack, monkeypatch: pytest.MonkeyPatch, transport: str, name: str
) -> None:
    cases = results(stack, name, transport=transport, patch=monkeypatch)
    assert len(cases) > 40
    assert failed(cases) == []


@pytest.mark.parametrize(("transport", "fault", "told"), FAULTS)
def test_a_fault_is_named(
    stack: ExitStack,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    transport: str,
    fault: str,
    told: str,
) -> None:
    name = COUPLER if transport == "tcp" else TOUCH
    cases = results(
        stack, name, transport=transport, fault=fault, folder=tmp_path, until=told,
        patch=monkeypatch,
    )  # fmt: skip
    assert told in cases[-1].problem


@pytest.mark.parametrize(("transport", "fault", "told"), [one for one in FAULTS if one[:2] in REAL])
def test_a_fault_is_named_on_a_real_link(
    stack: ExitStack, tmp_path: Path, transport: str, fault: str, told: str
) -> None:
    name = COUPLER if transport == "tcp" else TOUCH
    cases = results(stack, name, transport=transport, fault=fault, folder=tmp_path, until=told)
    assert told in cases[-1].problem


def results_in_memory(answers: Callable[[bytes], bool], link: LinkSpec) -> list[CaseResult]:
    """The results of a slave that answers only those requests of which `answers` is True."""
    profile = load_profile(TOUCH)
    wire = SlaveInMemory(profile, UNIT, answers=answers)
    return list(Conformance(profile, link, wire, UNIT).run())


LINE, NETWORK = SerialLink("/dev/line", FAST), TcpLink(Endpoint("127.0.0.1", 502))


@pytest.mark.parametrize("link", [LINE, NETWORK], ids=["rtu", "tcp"])
def test_a_test_of_a_unit_that_answers_nothing_ends_soon(link: LinkSpec) -> None:
    assert failed(results_in_memory(lambda pdu: False, link))[3:] == [
        "the unit answers: no answer to 3 requests; the other cases were not run"
    ]


@pytest.mark.parametrize(("lost", "is_failed"), [({20}, False), ({*range(5, 200, 5)}, True)])
def test_a_request_that_is_lost_once_is_a_note_and_one_of_five_a_failure(
    lost: set[int], *, is_failed: bool
) -> None:
    numbers = count(1)
    cases = results_in_memory(lambda pdu: next(numbers) not in lost, LINE)
    told = "got no answer, and the right one when it was asked again"
    assert any(told in one for one in noted(cases))
    assert any(told in one for one in failed(cases)) == is_failed


def test_a_unit_that_answers_one_function_of_two_is_tested_to_the_end() -> None:
    cases = results_in_memory(lambda pdu: pdu[0] not in (1, 2), LINE)
    assert len([one for one in cases if one.name.startswith("03 ")]) > 20
    assert len([one for one in cases if "got no answer" in one.problem]) > 40


def test_a_written_value_is_read_back_and_put_back(stack: ExitStack) -> None:
    cases = results(stack, TOUCH, transport="rtu", writes=("holding 0..2", "coil 0"))
    names = [one.name for one in cases if "put back" in one.name]
    assert len(names) == 4
    assert failed(cases) == []


def test_a_register_that_keeps_its_value_is_found(
    stack: ExitStack, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fault = "kind = 'stuck', registers = 'holding 1'"
    cases = results(
        stack, TOUCH, transport="rtu", fault=fault, folder=tmp_path, writes=("holding 0..2",),
        patch=monkeypatch,
    )  # fmt: skip
    assert failed(cases) == ["06 1: write, read back, put back: expected 1 to be read back, got 0"]


def test_values_that_are_not_as_written_are_found(
    stack: ExitStack, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fault = "kind = 'offset', registers = 'holding 2'"
    cases = results(
        stack, TOUCH, transport="rtu", fault=fault, folder=tmp_path, writes=("holding 0..2",),
        patch=monkeypatch,
    )  # fmt: skip
    (told,) = failed(cases)
    assert told.startswith("06 2: write, read back, put back: expected ")
