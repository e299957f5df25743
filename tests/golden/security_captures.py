"""The captures of attacks and scans in captures/findings, and what stays just below their limits.

Each takes the number of cases, so that the same capture with one case less is the one that nearly
shows the code.
"""

from __future__ import annotations

from mbtool.devices.checking.security_limits import SecurityLimits
from tests.golden.findings_captures import READ, VALUE, Bus, Case, Net, exchange
from tests.packets.building import MASTER

OTHER = "10.0.0.9"
LIMITS = SecurityLimits()
IDENTIFY = "2B 0E 01 00"
IDENTITY = "2B 0E 01 01 00 00 01 00 04 49444543"
WRITE = "06 0005 0001"


def late_host(after_s: float, request: str, answer: str, *, master: str = OTHER) -> bytes:
    """A host comes to a slave when another has asked it for so long."""
    net = Net()
    talk = net.open()
    net.asked(talk).wait(after_s * 500).asked(talk).wait(after_s * 500)
    return net.asked(net.open(50001, master=master), request, answer).wait(50).asked(talk).file()


def written_on_a_line(times: int) -> bytes:
    """A master that reads once, and then writes; its pauses are longer than the slave's."""
    bus = Bus().asked()
    for _ in range(times):
        bus.frame(1, WRITE, after_ms=12).frame(1, WRITE)
    return bus.file()


def scanned_hosts(number: int) -> bytes:
    """A host asks so many addresses, while a master polls as many others."""
    net = Net()
    polls = [net.open(49152 + one, slave=f"10.0.1.{one}") for one in range(1, number + 1)]
    for _ in range(3):
        for talk in polls:
            net.asked(talk)
    for one in range(1, number + 1):
        net.asked(net.open(50000 + one, master=OTHER, slave=f"10.0.0.{100 + one}"))
    return net.file()


def scanned_units(number: int) -> bytes:
    net = Net()
    talk = net.open()
    for unit in range(1, number + 1):
        net.asked(talk, READ, VALUE if unit == 1 else "83 0B", unit=unit)
    return net.file()


def scanned_functions(number: int) -> bytes:
    net = Net()
    talk = net.open()
    for function in range(0x64, 0x64 + number):
        net.asked(talk, f"{function:02X} 00", f"{function | 0x80:02X} 01")
    return net.file()


def scanned_registers(number: int) -> bytes:
    net = Net()
    talk = net.open()
    for address in range(number):
        net.asked(talk).asked(talk, f"03 {1000 + address:04X} 0001", "83 02")
    return net.file()


def _seconds(window_ns: int) -> float:
    return window_ns / 1e9


_SECOND_WRITER_S = _seconds(LIMITS.second_writer.window_ns)
_IDENTIFICATION_S = _seconds(LIMITS.identification.window_ns)

SECURITY_CASES = (
    Case(
        "SEC-101",
        lambda: late_host(_SECOND_WRITER_S + 1, WRITE, WRITE),
        lambda: late_host(_SECOND_WRITER_S - 1, WRITE, WRITE),
    ),
    Case(
        "SEC-102",
        lambda: written_on_a_line(LIMITS.line_write_flood.number),
        lambda: written_on_a_line(LIMITS.line_write_flood.number - 1),
    ),
    Case(
        "SEC-103",
        exchange("08 0004 0000", "88 01"),
        exchange("08 0002 0000", "08 0002 0000"),
    ),
    Case(
        "SEC-201",
        lambda: scanned_hosts(LIMITS.host_scan.number),
        lambda: scanned_hosts(LIMITS.host_scan.number - 1),
    ),
    Case(
        "SEC-202",
        lambda: scanned_units(LIMITS.unit_scan.number),
        lambda: scanned_units(LIMITS.unit_scan.number - 1),
    ),
    Case(
        "SEC-203",
        lambda: scanned_functions(LIMITS.function_scan.number),
        lambda: scanned_functions(LIMITS.function_scan.number - 1),
    ),
    Case(
        "SEC-204",
        lambda: scanned_registers(LIMITS.register_scan.number),
        lambda: scanned_registers(LIMITS.register_scan.number - 1),
    ),
    Case(
        "SEC-205",
        lambda: late_host(_IDENTIFICATION_S + 1, IDENTIFY, IDENTITY),
        lambda: late_host(_IDENTIFICATION_S + 1, IDENTIFY, IDENTITY, master=MASTER),
    ),
)
