"""Makes lines of JSON or CSV from the transactions of blocks."""

# The caller gives a function that makes the line of one transaction. To call it seldom, rows of
# common reads and writes (usual_rows.py) are grouped that differ only in time, ends, transaction
# id, values, raw bytes and packet numbers. For each group the function makes one line, with a
# random mark in each of these fields. The line of each row is this template with its own texts in
# place of the marks. So it is the same line that the function would make of the row.
#
# Memory: about MAX_LINES templates are kept; with more, all are forgotten and made again when
# needed.

from __future__ import annotations

import secrets
from collections import Counter
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np

from mbtool.columns.arrays import pieces
from mbtool.columns.column_decoder import order_of
from mbtool.columns.plain_transactions import plain_transaction
from mbtool.columns.usual_values import UsualValues
from mbtool.core import WireEvent
from mbtool.decode.decoder import Record
from mbtool.devices import NamedTransaction, Namer
from mbtool.modbus.transaction import Outcome

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from mbtool.columns.arrays import Int64s
    from mbtool.columns.column_decoder import DecodedBlock
    from mbtool.columns.plain_rows import PlainRows
    from mbtool.columns.usual_values import ValueLists

MAX_LINES = 65_536

_TEXTS = ("link", "source", "destination")
_NUMBERS = ("transaction_id", "response_ns", "latency_ns", "request_packet", "response_packet")
_LISTS = ("request_values", "response_values")
_RAW = ("request_raw", "response_raw")
_TIMES = ("request_ns", "time")
# Marks are random, so that no text of a capture, such as a file name, contains one by chance.
_MARKS = {name: f"<{secrets.token_hex(8)}:{name}>" for name in (*_TEXTS, *_NUMBERS, *_LISTS, *_RAW)}
"""For each field that varies, the text that marks its place in a template; it occurs nowhere else
in a line."""
_MARK_NS = 10**18 + secrets.randbelow(10**18)
_MARK_TIME = str(np.datetime_as_string(np.datetime64(_MARK_NS, "ns"), unit="ns"))
_WIDTHS = np.array([len(str(number)) + 1 for number in range(1 << 16)])
"""The length of each number from 0 to 65535 as text, plus 1 for the separator behind it."""


@dataclass(slots=True)
class LineBatch:
    """The lines of the transactions of a block of packets."""

    text: str
    """All lines of the block joined, in order."""
    outcomes: Counter[Outcome]
    """The number of transactions by outcome, without those in `records`."""
    records: list[Record]
    """In order: the events, and the transactions that the Decoder read packet by packet; behind
    them those of `made`. Opening and closing events of connections that were read from arrays from
    SYN to FIN are missing."""
    made: list[NamedTransaction] = field(default_factory=list)
    """Transactions found in the arrays whose PDUs are not the common reads and writes, so that each
    was made as an object; `records` has them too."""


class BlockLines:
    """Makes the lines of each block of a capture that is decoded without device profiles."""

    def __init__(self, line_of: Callable[[NamedTransaction], str], separator: str) -> None:
        """Take the format of the lines.

        `line_of` makes the line of one transaction. `separator`, one ASCII character, stands
        between the numbers of a list of values.
        """
        self._line_of = line_of
        self._words = np.array([f"{number}{separator}".encode() for number in range(1 << 16)])
        """Each number from 0 to 65535 as text with the separator behind it, padded with zero bytes
        to equal length."""
        self._namer = Namer()
        self._forms: dict[tuple[object, ...], str] = {}
        """The templates: lines with %s in place of the fields that vary, by the values of all other
        fields."""
        self._order: list[str] = []
        """The names of the fields that vary, in the order in which a line has them."""

    def batch(self, decoded: DecodedBlock) -> LineBatch:
        records = decoded.sorted_records()
        made = [one for _, one in records]
        rows = [(place, one) for place, one in records if not isinstance(one, WireEvent)]
        lines, order = [self._line_of(one) for _, one in rows], [place for place, _ in rows]
        plain = decoded.plain
        if plain is None:
            return LineBatch("".join(lines), Counter(), made)
        usual = UsualValues(plain)
        chosen = np.flatnonzero(usual.is_usual)
        others = np.flatnonzero(~usual.is_usual).tolist()
        unusual = [self._named(plain, index) for index in others]
        usual_lines = self._lines(plain, usual, chosen)
        refused = int(np.count_nonzero(usual.exception[chosen] >= 0))
        outcomes = Counter({Outcome.OK: len(chosen) - refused, Outcome.EXCEPTION: refused})
        if not (lines or unusual):
            return LineBatch("".join(usual_lines), outcomes, made)
        places = order_of(plain.response)
        lines += [self._line_of(one) for one in unusual] + usual_lines
        places = np.concatenate([np.array(order, np.int64), places[others], places[chosen]])
        ordered = [lines[one] for one in np.argsort(places, kind="stable").tolist()]
        return LineBatch("".join(ordered), outcomes, [*made, *unusual], unusual)

    def _named(self, rows: PlainRows, index: int) -> NamedTransaction:
        return self._namer.name(plain_transaction(rows, index))

    def _lines(self, rows: PlainRows, usual: UsualValues, chosen: Int64s) -> list[str]:
        if not len(chosen):
            return []
        forms, kinds = self._forms_of(rows, usual, chosen)
        fields = self._fields(rows, usual, chosen)
        texts = zip(*(fields[name] for name in self._order), strict=True)
        return [forms[kind] % some for kind, some in zip(kinds, texts, strict=True)]

    def _forms_of(
        self, rows: PlainRows, usual: UsualValues, chosen: Int64s
    ) -> tuple[list[str], list[int]]:
        """Return the templates of the rows' lines, and for each row the index of its template."""
        numbers: dict[object, int] = {}
        place_of = np.array([numbers.setdefault(one, len(numbers)) for one in rows.addresses])
        places = [*numbers]
        asked = usual.exception + 1 << 48 | rows.code << 40 | rows.unit << 32
        asked = (asked | usual.address << 16 | usual.quantity)[chosen]
        distinct, like = np.unique(asked, return_inverse=True)
        both = place_of[rows.connection[chosen]] * len(distinct) + like
        _, first, kinds = np.unique(both, return_index=True, return_inverse=True)
        if len(self._forms) > MAX_LINES:
            self._forms.clear()
        forms = []
        for one in first.tolist():
            index = int(chosen[one])
            place = places[place_of[rows.connection[index]]]
            key = rows.block.file, place, int(asked[one])
            if key not in self._forms:
                self._forms[key] = self._form(self._named(rows, index))
            forms.append(self._forms[key])
        return forms, kinds.tolist()

    def _form(self, like: NamedTransaction) -> str:
        """Return the line of a transaction as a template, with %s in place of each field that
        varies between rows.
        """
        if not self._order:
            line = self._line_of(_marked(like, is_full=True))
            places = {name: line.index(_mark_of(name)) for name in (*_MARKS, *_TIMES)}
            self._order = sorted(places, key=places.__getitem__)
        line = self._line_of(_marked(like, is_full=False)).replace("%", "%%")
        for name in (*_NUMBERS, *_LISTS):
            # JSON puts the mark in quotes, as a text; the numbers that take its place have none.
            line = line.replace(f'"{_MARKS[name]}"', _MARKS[name])
        form = ""
        for name in self._order:
            before, mark, after = line.partition(_mark_of(name))
            form += f"{before}%s" if mark else "%.0s"
            line = after if mark else before
        return form + line

    def _fields(
        self, rows: PlainRows, usual: UsualValues, chosen: Int64s
    ) -> dict[str, Sequence[object]]:
        """For each field that varies, return a list with its text or number for each row."""
        ends = rows.connection[chosen].tolist()
        request_ns, response_ns = rows.request_ns[chosen], rows.response_ns[chosen]
        first = rows.block.first_number
        links, masters, slaves = (
            [text(one) for one in rows.connections]
            for text in (
                lambda one: one.link,
                lambda one: str(one.master),
                lambda one: str(one.slave),
            )
        )
        return {
            "link": [links[one] for one in ends],
            "source": [masters[one] for one in ends],
            "destination": [slaves[one] for one in ends],
            "transaction_id": rows.transaction_id[chosen].tolist(),
            "request_ns": request_ns.tolist(),
            "response_ns": response_ns.tolist(),
            "latency_ns": (response_ns - request_ns).tolist(),
            "request_packet": (first + rows.request[chosen]).tolist(),
            "response_packet": (first + rows.response[chosen]).tolist(),
            "request_values": self._texts(usual.request_values(chosen)),
            "response_values": self._texts(usual.response_values(chosen)),
            "request_raw": _hex(rows, rows.request_begin[chosen], rows.request_size[chosen]),
            "response_raw": _hex(rows, rows.response_begin[chosen], rows.response_size[chosen]),
            "time": np.datetime_as_string(request_ns.view("datetime64[ns]"), unit="ns").tolist(),
        }

    def _texts(self, lists: ValueLists) -> list[str]:
        """Return for each row its list of numbers as text, with separators between them; empty for
        a missing list.
        """
        padded = self._words[lists.numbers].view(np.uint8)
        text = padded[padded != 0].tobytes().decode()
        ends = np.concatenate([[0], np.cumsum(_WIDTHS[lists.numbers])])[lists.offsets]
        # Cut off the separator behind the last number of each row.
        stops = np.maximum(ends[1:] - 1, ends[:-1])
        return [
            text[begin:end] for begin, end in zip(ends[:-1].tolist(), stops.tolist(), strict=True)
        ]


class _HexMark:
    """Takes the place of a transaction's raw bytes; its hexadecimal text is a mark."""

    def __init__(self, name: str) -> None:
        self._name = name

    def hex(self) -> str:
        return _MARKS[self._name]


def _mark_of(name: str) -> str:
    if name == "time":
        return _MARK_TIME
    return str(_MARK_NS) if name == "request_ns" else _MARKS[name]


def _marked(like: NamedTransaction, *, is_full: bool) -> NamedTransaction:
    """Return a transaction whose varying fields are marks.

    `is_full` is True to put a mark also into value lists that are None.
    """
    fields: dict[str, Any] = {name: _MARKS[name] for name in (*_TEXTS, *_NUMBERS)}
    fields |= {name: _HexMark(name) for name in _RAW}
    for name in _LISTS:
        if is_full or getattr(like, name) is not None:
            fields[name] = [_MARKS[name]]
    return msgspec.structs.replace(like, request_ns=_MARK_NS, **fields)


def _hex(rows: PlainRows, begins: Int64s, sizes: Int64s) -> list[str]:
    """Return hexadecimal text for each byte range of a block's data; `begins` and `sizes` are in
    bytes.
    """
    text = pieces(rows.data, begins, sizes).tobytes().hex()
    return [*_cut(text, 2 * sizes)]


def _cut(text: str, sizes: Int64s) -> Iterator[str]:
    ends = np.cumsum(sizes)
    for begin, end in zip((ends - sizes).tolist(), ends.tolist(), strict=True):
        yield text[begin:end]
