"""Attacks and scans in whole captures: slaves that do not answer, closed ports, serial lines."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mbtool.packets.segment import ACK, RST, SYN
from mbtool.workflows.check import CheckRun, CodeFilter
from mbtool.workflows.shared.reading import ReadingOptions
from tests.golden.findings_captures import READ, VALUE, Bus, Net
from tests.packets.building import End, Talk

if TYPE_CHECKING:
    from pathlib import Path

    from mbtool.devices.checking.finding import Finding

INTRUDER = "10.0.0.99"


def found(folder: Path, *parts: bytes) -> list[Finding]:
    """The findings about attacks and scans in the parts of one capture."""
    paths = []
    for number, data in enumerate(parts):
        path = folder / f"part{number}.pcap"
        path.write_bytes(data)
        paths.append(str(path))
    run = CheckRun(paths, ReadingOptions(), CodeFilter.parse(["SEC"], []))
    return [placed.finding for placed in run.findings()]


def test_a_scan_of_units_that_do_not_answer_is_found_beside_a_plant(tmp_path: Path) -> None:
    net = Net()
    plant = [net.open(40000 + one, slave=f"10.0.0.{10 + one}") for one in range(20)]
    intruder = net.open(50001, master=INTRUDER, slave="10.0.0.10")
    for second in range(20):
        for talk in plant:
            net.asked(talk)
        net.ask(intruder, READ, unit=100 + second).wait(900)
    (finding,) = found(tmp_path, net.file())
    assert (finding.code, finding.count) == ("SEC-202", 20)
    assert finding.message.startswith(f"{INTRUDER} asks 20 units of 10.0.0.10:502")


def test_a_scan_of_closed_ports_is_found(tmp_path: Path) -> None:
    net = Net()
    for one in range(30):
        talk = Talk(End(INTRUDER, 50000 + one, 1000), End(f"10.0.1.{one}", 502, 5000))
        net.add(talk.send(talk.master, flags=SYN))
        if one % 2:  # The others do not exist.
            net.add(talk.send(talk.slave, flags=RST | ACK))
    (finding,) = found(tmp_path, net.file())
    assert (finding.code, finding.count) == ("SEC-201", 30)


def test_a_scan_of_a_line_is_found(tmp_path: Path) -> None:
    bus = Bus()
    for unit in range(1, 100):
        bus.frame(unit, READ, after_ms=300)
        if unit in (1, 5, 17):
            bus.frame(unit, VALUE)
    (finding,) = found(tmp_path, bus.file())
    assert (finding.code, finding.count, finding.source) == ("SEC-202", 99, None)


def test_the_first_minutes_are_those_of_the_first_part_of_a_capture(tmp_path: Path) -> None:
    net = Net()
    talk = net.open()
    for _ in range(5):
        net.wait(100_000).asked(talk)
    first = net.file()
    net.packets.clear()
    net.wait(400_000).asked(talk)
    net.asked(net.open(50001, master=INTRUDER), "11", "11 02 01 FF")
    (finding,) = found(tmp_path, first, net.file())
    assert (finding.code, finding.source) == ("SEC-205", f"{INTRUDER}:50001")
    assert [one.code for one in found(tmp_path, net.file())] == []
