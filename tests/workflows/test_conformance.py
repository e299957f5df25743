"""A slave that does as its profile says passes, and each deviation is named."""

from __future__ import annotations

from contextlib import ExitStack
from typing import TYPE_CHECKING, Any

import pytest

from mbtool.core import Endpoint, LinkError, SerialFormat, SerialLink, TcpLink, parse_link
from mbtool.devices import builtin_profiles, load_profile, parse_span
from mbtool.master.wire import open_wire
from mbtool.modbus.adu import Transport
from mbtool.sources.virtual_line import VirtualLine
from mbtool.workflows.conformance import Conformance, Result
from mbtool.workflows.slave import device_slave

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from mbtool.workflows.conformance import CaseResult

FAST = SerialFormat(baud=115200, parity="N")
TIMEOUT_NS = 3_000_000_000
UNIT = 5
TOUCH = "idec-ft1a-touch"
COUPLER = "wago-750"
FAULTS: dict[str, dict[str, Any]] = {
    "no answer": {"kind": "no-answer"},
    "no answer to 03": {"kind": "no-answer", "functions": [3]},
    "an exception in place of values": {"kind": "exception", "functions": [3]},
    "another exception code": {"kind": "exception", "code": 3},
    "another unit": {"kind": "wrong-unit"},
    "a byte is missing": {"kind": "truncated", "bytes": 1},
    "two bytes are missing": {"kind": "truncated", "bytes": 2},
    "an extra byte": {"kind": "extra-bytes"},
    "each fifth answer is missing": {"kind": "no-answer", "every": 5},
    "answers are late": {"kind": "delay", "ms": 4000},
}
OF_SERIAL = {"a wrong CRC": {"kind": "bad-crc"}}
OF_TCP = {
    "another transaction id": {"kind": "wrong-id"},
    "it closes": {"kind": "close"},
    "it resets": {"kind": "reset"},
}


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
    is_serial: bool,
    fault: dict[str, Any] | None = None,
    writes: tuple[str, ...] = (),
    folder: Path | None = None,
    ends_early: bool = False,
) -> list[CaseResult]:
    profile = load_profile(name)
    faults = None
    if fault is not None:
        assert folder is not None
        faults = folder / "fault.toml"
        lines = "\n".join(f"{key} = {value!r}" for key, value in fault.items())
        faults.write_text(f"[[faults]]\n{lines}\n".replace("'", '"'))
    if is_serial:
        line = stack.enter_context(VirtualLine(ends=2, format=FAST))
        theirs, ours = (SerialLink(port, FAST) for port in line.ports)
        slave = device_slave(profile, theirs, UNIT, fault_file=faults)
    else:
        slave = device_slave(profile, TcpLink(Endpoint("127.0.0.1", 0)), UNIT, fault_file=faults)
    stack.enter_context(slave)
    link = ours if is_serial else parse_link(slave.place, "the slave")
    known = profile.in_mode(Transport.RTU if is_serial else Transport.TCP)
    spans = [parse_span(text, [known]) for text in writes]
    with open_wire(link, TIMEOUT_NS, 0) as wire:
        work = Conformance(known, link, wire, UNIT)
        return list(work.run(spans, lambda: ends_early and bool(failed(work.report.cases))))


def test_the_embedded_slave_passes_with_rtu_over_tcp(stack: ExitStack) -> None:
    profile = load_profile(TOUCH)
    slave = stack.enter_context(
        device_slave(profile, TcpLink(Endpoint("127.0.0.1", 0), rtu=True), UNIT)
    )
    link = parse_link(slave.place, "the slave")
    with open_wire(link, TIMEOUT_NS, 0) as wire:
        known = profile.in_mode(Transport.RTU_TCP)
        cases = list(Conformance(known, link, wire, UNIT).run())
    assert len(cases) > 40
    assert failed(cases) == []


def failed(cases: list[CaseResult]) -> list[str]:
    return [f"{one.name}: {one.problem}" for one in cases if one.result is Result.FAILED]


@pytest.mark.parametrize(
    "name", [one for one in builtin_profiles() if of_transport(one, Transport.TCP)]
)
def test_the_embedded_slave_of_a_profile_passes_on_tcp(stack: ExitStack, name: str) -> None:
    cases = results(stack, name, is_serial=False)
    assert len(cases) > 40
    assert failed(cases) == []


@pytest.mark.parametrize(
    "name", [one for one in builtin_profiles() if of_transport(one, Transport.RTU)]
)
def test_the_embedded_slave_of_a_profile_passes_on_a_line(stack: ExitStack, name: str) -> None:
    cases = results(stack, name, is_serial=True)
    assert len(cases) > 40
    assert failed(cases) == []


@pytest.mark.parametrize(
    ("is_serial", "what"),
    [
        *((True, what) for what in FAULTS | OF_SERIAL),
        *((False, what) for what in FAULTS | OF_TCP),
    ],
)
def test_a_fault_is_found(stack: ExitStack, tmp_path: Path, *, is_serial: bool, what: str) -> None:
    fault = (FAULTS | OF_SERIAL | OF_TCP)[what]
    name = TOUCH if is_serial else COUPLER
    try:
        cases = results(
            stack, name, is_serial=is_serial, fault=fault, folder=tmp_path, ends_early=True
        )
    except LinkError:
        assert what in ("it closes", "it resets")
        return
    assert failed(cases)


def test_a_written_value_is_read_back_and_put_back(stack: ExitStack) -> None:
    cases = results(stack, TOUCH, is_serial=True, writes=("holding 0..2", "coil 0"))
    names = [one.name for one in cases if "put back" in one.name]
    assert len(names) == 4
    assert failed(cases) == []


def test_a_register_that_keeps_its_value_is_found(stack: ExitStack, tmp_path: Path) -> None:
    fault = {"kind": "stuck", "registers": "holding 1"}
    cases = results(
        stack, TOUCH, is_serial=True, fault=fault, folder=tmp_path, writes=("holding 0..2",)
    )
    assert failed(cases) == ["06 1: write, read back, put back: expected 1 to be read back, got 0"]
