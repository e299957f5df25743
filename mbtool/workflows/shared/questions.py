"""Makes request PDUs from a user's text: `HR400001..400010`, `holding 0`, `HR400001=4660`."""

# The user can name the registers or bits to read or write by
#
#     a reference             HR400001..400010, X0..XF, in the notation of the device's profile
#     the name of a point     "CH1 digital value", a named value of the profile; or the reference of
#                             its first register. All its registers are read; a value to write is in
#                             the point's unit.
#     a table and an address  holding 0..9, hr 0x10, coil 3; addresses as on the wire, 0-based
#     five or six digits      40001 and 400001 (or HR400001) are holding 0, 300001 input 0, 100001
#                             discrete 0, 000001 coil 0; only without a profile, as some vendors
#                             count otherwise
#     hr10, ir10              the same as hr 10, without a profile
#     an address alone        0x10..0x1f, if the user chose a function, which determines the table
#
# A range that is longer than the device or the standard allows is read with several requests. A
# point of several registers is not divided between two requests, if it fits into one. A write is
# never divided, so that a device never has only a part of the new values.

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from mbtool.core import Direction, UsageError
from mbtool.devices import Profile, Span, parse_span
from mbtool.modbus import FUNCTIONS, encode_pdu
from mbtool.modbus.tables import DIGIT_TABLES, READS_OF_TABLE, Table
from mbtool.slave.device.value_targets import ValueTarget, ValueTargets

_WRITES = {Table.COILS: (0x05, 0x0F), Table.HOLDING_REGISTERS: (0x06, 0x10)}
"""For each table that can be written: the function code that writes one value, and the one that
writes several."""
READ_FUNCTIONS = tuple(READS_OF_TABLE.values())
WRITE_FUNCTIONS = tuple(sorted(code for codes in _WRITES.values() for code in codes))

_DIGITS = re.compile(r"(?:HR|IR|I|C)?([0134])(\d{4,5})", re.ASCII | re.IGNORECASE)
_GLUED = re.compile(r"(hr|ir|di|co)(\d{1,5}|0x[0-9a-f]{1,4})", re.ASCII | re.IGNORECASE)
_WORDS = {
    Table.COILS: "coil",
    Table.DISCRETE_INPUTS: "discrete",
    Table.HOLDING_REGISTERS: "holding",
    Table.INPUT_REGISTERS: "input",
}
_ADDRESS = re.compile(r"\d{1,5}|0x[0-9a-f]{1,4}", re.ASCII | re.IGNORECASE)
_INTEGER = re.compile(r"[+-]?(?:\d{1,20}|0x[0-9a-f]{1,16})", re.ASCII | re.IGNORECASE)
_BIT_WORDS = {"on": 1, "true": 1, "off": 0, "false": 0}


@dataclass(frozen=True, slots=True)
class Wording:
    """Interprets texts that name registers or bits, with the profile of a device and the function
    that the user chose.
    """

    profile: Profile | None = None
    """The profile of the device, with its limits for the mode of the link (RTU, ASCII or TCP); None
    if it has none."""
    function: int | None = None
    """The function code that the user chose; None to use the table's usual one."""

    def __post_init__(self) -> None:
        known = (*READ_FUNCTIONS, *WRITE_FUNCTIONS)
        if self.function is not None and self.function not in known:
            raise UsageError(
                f"--function {self.function}: write one of {', '.join(map(str, known))}"
            )

    def reads(self, text: str) -> list[bytes]:
        """Return the PDUs of the requests that read the registers or bits which `text` names.

        Raises UsageError if the text names none, or if the chosen function cannot read them.
        """
        table, span = self.addresses(text)
        code = self._code(text, table, (READS_OF_TABLE[table],))
        return [
            encode_pdu(code, Direction.REQUEST, address=part.start, quantity=len(part))
            for part in self._parts(code, table, span)
        ]

    def write(self, text: str) -> bytes:
        """Return the PDU of the request that writes what `text` says: `REFERENCE=VALUE` or
        `REFERENCE=VALUE,VALUE`.

        Raises UsageError for a text of another form, for a table that can only be read, for a value
        out of range, and for more values than the device takes in one request.
        """
        name, equals, values_text = text.rpartition("=")
        if not equals or not name.strip() or not values_text.strip():
            raise UsageError(
                f"{text!r}: write REFERENCE=VALUE, for example 'holding 0=4660', or several values "
                "with commas: 'holding 0=1,2,3'"
            )
        target = self._target(name.strip())
        if not target.table.is_writable:
            raise UsageError(f"{name.strip()!r}: {_WORDS[target.table]}s can only be read")
        try:
            values = target.all_registers(_value(values_text, target))
        except UsageError as error:
            raise UsageError(f"{text!r}: {error}") from error
        code = self._write_code(text, target.table, len(values))
        if len(values) > self._limit(code):
            raise UsageError(
                f"{text!r}: {len(values)} values, and one request writes at most "
                f"{self._limit(code)}; a write is not divided"
            )
        if code in (0x05, 0x06):
            value = values[0] if code == 0x06 else 0xFF00 * values[0]
            return encode_pdu(code, Direction.REQUEST, address=target.address, value=value)
        return encode_pdu(code, Direction.REQUEST, address=target.address, values=tuple(values))

    def addresses(self, text: str) -> tuple[Table, range]:
        """Return the table and the addresses (on the wire, 0-based) of the registers or bits that
        `text` names.

        Raises UsageError if the text names none.
        """
        if ".." in text:
            try:
                span = self._span(text)
            except UsageError:
                if self.profile is None:
                    raise
                # The name of a point may have dots in it.
                named = _target_of_name(self.profile, text)
                if named is None:
                    raise
                return named.table, _addresses(named)
            return span.table, range(span.first, span.last + 1)
        target = self._target(text)
        return target.table, _addresses(target)

    def _target(self, text: str) -> ValueTarget:
        neutral = self._neutral(text)
        if self.profile is not None:
            return ValueTargets(self.profile).find(neutral)
        span = self._span(text)
        if span.last > span.first:
            raise UsageError(f"{text!r}: name the first address, and list the values behind it")
        return ValueTarget(span.table, span.first, None)

    def _span(self, text: str) -> Span:
        own = () if self.profile is None else (self.profile,)
        return parse_span(self._neutral(text), own)

    def _neutral(self, text: str) -> str:
        """Rewrite five or six digits, an address alone, or `hr10` as table and address: `400001`
        becomes `holding 0`.

        Any other text is returned unchanged.
        """
        begin, dots, end = text.strip().partition("..")
        if self.function is not None and _ADDRESS.fullmatch(begin):
            table = FUNCTIONS[self.function].table
            assert table is not None
            return f"{_WORDS[table]} {begin}{dots}{end}"
        if self.profile is not None and self.profile.has_rules:
            return text
        digits = _DIGITS.fullmatch(begin)
        if digits is None or not int(digits[2]):
            glued = None if digits is not None else _GLUED.fullmatch(begin)
            return text if glued is None else f"{glued[1]} {glued[2]}{dots}{end}"
        if dots and (last := _DIGITS.fullmatch(end)) is not None and last[1] == digits[1]:
            end = str(int(last[2]) - 1)
        elif dots:
            return text
        return f"{_WORDS[DIGIT_TABLES[digits[1]]]} {int(digits[2]) - 1}{dots}{end}"

    def _code(self, text: str, table: Table, usual: Sequence[int]) -> int:
        """Return the function code that the user chose, or else the first of `usual`, the codes
        that fit.

        Raises UsageError if the chosen code is not in `usual`; the message quotes `text`.
        """
        if self.function is None:
            return usual[0]
        if self.function not in usual:
            fitting = " or ".join(map(str, usual))
            raise UsageError(
                f"--function {self.function} does not fit {text!r}, for which it is {fitting}"
            )
        return self.function

    def _write_code(self, text: str, table: Table, count: int) -> int:
        one, several = _WRITES[table]
        own = self.profile if self.profile is not None and self.profile.has_rules else None
        lacks_one = own is not None and own.rule(one) is None
        has_several = own is not None and own.rule(several) is not None
        if count > 1:
            if own is not None and self.function is None and not has_several:
                raise UsageError(
                    f"{text!r}: {own.name} has no function {several:02X} to write several "
                    f"at once; give each value its own name, or choose it with --function {several}"
                )
            return self._code(text, table, (several,))
        return self._code(
            text, table, (several, one) if lacks_one and has_several else (one, several)
        )

    def _limit(self, code: int) -> int:
        """The number of registers or bits that one request with function `code` may read or write
        at most.
        """
        rule = None if self.profile is None else self.profile.rule(code)
        own = None if rule is None else rule.limit
        return FUNCTIONS[code].limit if own is None else min(own, FUNCTIONS[code].limit)

    def _parts(self, code: int, table: Table, span: range) -> Iterator[range]:
        """Divide the addresses `span` into parts that one request with function `code` can read.

        Points of several registers are not divided, if they fit into one request.
        """
        limit, inside = self._limit(code), self._inside(table)
        start = span.start
        while span.stop - start > limit:
            end = start + limit
            while end in inside and end > start:
                end -= 1
            end = end if end > start else start + limit
            yield range(start, end)
            start = end
        yield range(start, span.stop)

    def _inside(self, table: Table) -> set[int]:
        """The addresses of all registers that are not the first register of their point, as the
        profile says.

        A request that begins at one of them would divide the point. A point with a block is left
        out.
        """
        if self.profile is None:
            return set()
        return {
            at
            for point in self.profile.points
            if point.table is table and point.words > 1 and point.block is None
            for first in point.addresses
            for at in range(first + 1, first + point.words)
        }


def _target_of_name(profile: Profile, name: str) -> ValueTarget | None:
    try:
        return ValueTargets(profile).find(name)
    except UsageError:
        return None


def _addresses(target: ValueTarget) -> range:
    """Return the addresses to read for a target: a point, a register or a bit.

    Some devices give a point only in reads that begin at a certain address, the point's block. Then
    the addresses begin there.
    """
    first = target.address
    if target.point is not None and target.point.block is not None:
        first = target.point.block
    return range(first, target.address + target.words)


def _value(text: str, target: ValueTarget) -> object:
    """Parse the text behind the `=`: a number, a text, or a list if it has commas. `target` is what
    to write to.
    """
    point = target.point
    if point is not None and text.strip() in point.texts.values():
        return text.strip()
    if point is not None and point.length is not None and target.is_named:
        return text  # A string may contain commas.
    parts = [_number(part.strip(), is_bit=target.table.is_bits) for part in text.split(",")]
    return parts[0] if len(parts) == 1 else parts


def _number(text: str, *, is_bit: bool) -> object:
    if is_bit and text.lower() in _BIT_WORDS:
        return _BIT_WORDS[text.lower()]
    if _INTEGER.fullmatch(text):
        return int(text, 16 if "x" in text.lower() else 10)
    try:
        return float(text)
    except ValueError:
        return text
