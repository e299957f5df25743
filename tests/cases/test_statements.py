"""What the manuals state, tried on the slave, on decode and on check.

The files of statements/ were written from the text of the manuals, page by page, a statement each:
the bytes of a request in a state of the device, with the response, the reference, the words and the
blame that the manual gives them. A statement that does not hold yet has `open`, the reason.
"""

from __future__ import annotations

import tomllib
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec
import pytest

from mbtool.core import SerialLink, TcpLink, parse_link
from mbtool.devices import load_profile
from mbtool.devices.checking.capture_context import CaptureContext
from mbtool.devices.checking.checker import Checker
from mbtool.devices.checking.rules import DeviceCode
from mbtool.modbus import Table, ascii_adu, rtu_adu
from mbtool.slave.device import RegisterImage
from mbtool.slave.device.responder import units_on
from mbtool.slave.families import make_device
from tests.devices.checking.talk import assigned, transaction

if TYPE_CHECKING:
    from mbtool.devices import NamedTransaction

FOLDER = Path(__file__).with_name("statements")
LEAST = 60
"""Each manual has at least this many statements."""
MOST_OPEN = 0.02
"""At most this share of a manual's statements may be open."""
LINKS = {"rtu": parse_link("rtu:/dev/ttyUSB0@19200-8E1"), "tcp": parse_link("tcp:127.0.0.1:502")}
OF_MASTER, OF_SLAVE = "FQAWDVU", "CERM"  # L is a note about a doubtful figure
SLAVES_OWN = {"FA3-X9", "FA3-X11", "FA3-X12", "MB-403"}


class Statement(msgspec.Struct, forbid_unknown_fields=True, kw_only=True):
    """A statement of a manual."""

    page: str
    says: str
    request: str
    """The PDU of the request, in hex."""
    response: str | list[str]
    """The PDU of the response; empty for none. Of several, the manual allows each."""
    unit: int = 1
    device: str = ""
    """The profile, where it is another one than that of the file."""
    set: list[str] = []
    """Values before: table, first address in hex, then words in hex or bits."""
    before: list[str] = []
    """Requests before, in hex; `UNIT/` stands before those for another unit."""
    reference: str = ""
    shows: list[str] = []
    """Parts of the names and texts of the points that decode shows."""
    fault: str = ""
    """`master`, `slave` or `both`: who is told to be wrong; empty for nobody."""
    slave: bool = True
    check: bool = True
    frame: str = ""
    ascii: str = ""
    open: str = ""
    """The reason why the statement does not hold, if it does not."""

    @property
    def responses(self) -> list[str]:
        return [self.response] if isinstance(self.response, str) else self.response


class Manual(msgspec.Struct, forbid_unknown_fields=True):
    manual: str
    device: str
    link: str
    statements: list[Statement]


MANUALS = {
    path.stem: msgspec.convert(tomllib.loads(path.read_text(encoding="utf-8")), Manual)
    for path in sorted(FOLDER.glob("*.toml"))
}


def _each() -> list[Any]:
    found = []
    for name, manual in MANUALS.items():
        for number, one in enumerate(manual.statements, 1):
            marks = [pytest.mark.xfail(reason=one.open, strict=True)] if one.open else []
            found.append(pytest.param(manual, one, id=f"{name}-{number}", marks=marks))
    return found


each_statement = pytest.mark.parametrize(("manual", "statement"), _each())


@each_statement
def test_a_statement_of_a_manual_holds(manual: Manual, statement: Statement) -> None:
    device = statement.device or manual.device
    if statement.frame:
        pdu = bytes.fromhex(statement.request)
        assert rtu_adu(statement.unit, pdu) == bytes.fromhex(statement.frame)
    if statement.ascii:
        pdu = bytes.fromhex(statement.request)
        assert ascii_adu(statement.unit, pdu) == f"{statement.ascii}\r\n".encode()
    if statement.slave:
        assert _answered(manual, device, statement) in [
            bytes.fromhex(one) for one in statement.responses
        ]
    if statement.unit == 0 and manual.link == "rtu":
        return  # A broadcast is no transaction with a response.
    named, *others = _records(manual, device, statement)
    if statement.reference:
        assert named.reference == statement.reference
    words = " ".join(f"{point.name} {point.text}" for point in named.points)
    values = " ".join(map(str, named.response_values or ()))
    for part in statement.shows:
        assert part in words or part in values, words
    if statement.check:
        both = {"master", "slave"} if statement.fault == "both" else {statement.fault}
        assert _blamed(device, [named, *others]) == both - {""}, named.findings


def _answered(manual: Manual, device: str, statement: Statement) -> bytes:
    profile = load_profile(device)
    image = RegisterImage.of(profile)
    for text in statement.set:
        table, address, *values = text.split()
        base = 16 if table.endswith("registers") else 2
        image.set(Table(table), int(address, 16), [int(value, base) for value in values])
    link = LINKS[manual.link]
    assert isinstance(link, SerialLink | TcpLink)
    units = units_on(link, profile, statement.unit or 1, make_device(profile, image))
    now_ns = 0
    for text in statement.before:
        unit, _, pdu = text.rpartition("/")
        now_ns += 10_000_000_000
        units.respond(int(unit or statement.unit), bytes.fromhex(pdu), now_ns)
    response = units.respond(
        statement.unit, bytes.fromhex(statement.request), now_ns + 10_000_000_000
    )
    return b"" if response is None else response.pdu


def _records(manual: Manual, device: str, statement: Statement) -> list[NamedTransaction]:
    """The request with its response; each of its own if the response has another function."""
    made = partial(transaction, unit=statement.unit, on_a_line=manual.link == "rtu", profile=device)
    response = statement.responses[0]
    if response and bytes.fromhex(response)[0] & 0x7F != bytes.fromhex(statement.request)[0]:
        usual = made("03 0000 0001", "03 02 0000")
        return [made(statement.request, None, at_ms=100), usual, made("", response, at_ms=105)]
    return [made(statement.request, response or None)]


def _blamed(device: str, records: list[NamedTransaction]) -> set[str]:
    checker = Checker(CaptureContext(assigned(device)))
    found = [finding for one in records for finding in checker.feed(one)]
    codes = {one.code for one in (*found, *checker.close())}
    return {side for code in codes if (side := _side(code))}


def _side(code: str) -> str:
    parsed = DeviceCode.parse(code)
    letter = parsed.rule.code if parsed is not None else ""
    if code in SLAVES_OWN or code.startswith("MB-2") or (letter and letter in OF_SLAVE):
        return "slave"
    is_masters = code.startswith("MB-1") or (letter and letter in OF_MASTER)
    return "master" if is_masters else ""


@pytest.mark.parametrize("name", MANUALS)
def test_a_manual_has_enough_statements_and_few_of_them_are_open(name: str) -> None:
    statements = MANUALS[name].statements
    assert len(statements) >= LEAST
    assert sum(bool(one.open) for one in statements) <= MOST_OPEN * len(statements)
    assert len({msgspec.json.encode(one) for one in statements}) == len(statements)
