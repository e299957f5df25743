"""Formats the transactions of each block of packets as lines of JSON or CSV."""

# The caller gives a function that formats one transaction as a line. It is slow, so it is called as
# rarely as possible. Transactions with usual reads and writes (usual_rows.py) are grouped; in a
# group they differ only in time, ends, transaction id, values, raw bytes and packet numbers. The
# function formats one transaction of each group with a random mark in each of these fields. The
# result is a template: the line of each transaction is the template with the transaction's own
# texts in place of the marks. So it equals the line that the function would have made. In a group
# of few transactions, the function formats each of them, because a template would cost more.
#
# Memory: about MAX_LINES templates are kept. If there are more, all are forgotten and made again
# when needed.

from __future__ import annotations

import secrets
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np

from mbtool.columns.arrays import Int64s, pieces
from mbtool.columns.column_decoder import DecodedBlock, result_sort_keys
from mbtool.columns.plain_transactions import PlainObjects, RowObjects
from mbtool.columns.usual_values import UsualValues, ValueLists
from mbtool.core import WireEvent
from mbtool.decode.decoder import Record
from mbtool.devices import NamedTransaction, Namer
from mbtool.modbus.transaction import Outcome

if TYPE_CHECKING:
    from mbtool.columns.plain_rows import PlainRows

MAX_LINES = 65_536
"""If there are more templates than this, all are forgotten before the next block."""
MIN_TEMPLATE_ROWS = 4
"""A template is made for a group that has at least this many rows in a block; the lines of smaller
groups are made one by one, which is faster."""

_TEXTS = ("link", "source", "destination")
_NUMBERS = ("transaction_id", "response_ns", "latency_ns", "request_packet", "response_packet")
_LISTS = ("request_values", "response_values")
_RAW = ("request_raw", "response_raw")
_TIMES = ("request_ns", "time")
# Marks are random, so that no text of a capture, such as a file name, contains one by chance.
_MARKS = {name: f"<{secrets.token_hex(8)}:{name}>" for name in (*_TEXTS, *_NUMBERS, *_LISTS, *_RAW)}
"""For each field that differs within a group, the mark that stands for it in a template; a mark
occurs nowhere else in a line."""
_MARK_NS = 10**18 + secrets.randbelow(10**18)
_MARK_TIME = str(np.datetime_as_string(np.datetime64(_MARK_NS, "ns"), unit="ns"))
_WIDTHS = np.array([len(str(number)) + 1 for number in range(1 << 16)])
"""The number of digits of each number from 0 to 65535, plus 1 for the separator behind it."""


@dataclass(slots=True)
class LineBatch:
    """The lines of the transactions of a block of packets."""

    text: str
    """All lines of the block joined, in the order in which packets completed the transactions."""
    outcomes: Counter[Outcome]
    """The number of transactions with each outcome, not counting the transactions in `records`."""
    records: list[Record]
    """First the events and the transactions that the Decoder read packet by packet, in the order in
    which packets completed them; then the transactions of `made`. The opening and closing events
    are missing for a connection that was read from arrays as a whole, from SYN to FIN."""
    made: list[NamedTransaction] = field(default_factory=list)
    """The transactions that were read from arrays but are not usual reads or writes
    (usual_rows.py), so that an object was made for each."""

    @property
    def row_count(self) -> int:
        """The number of transactions and events, for a progress bar."""
        return self.outcomes.total() + len(self.records)


class BlockLines:
    """Formats each block of a capture as lines."""

    def __init__(
        self,
        line_of: Callable[[NamedTransaction], str],
        separator: str,
        namer: Namer | None = None,
    ) -> None:
        """Take the format of the lines.

        `line_of` formats one transaction, with the end of the line. `separator`, one ASCII
        character, stands between the numbers of a list of values.
        """
        self._line_of = line_of
        self._words = np.array([f"{number}{separator}".encode() for number in range(1 << 16)])
        """Each number from 0 to 65535 as ASCII text with the separator behind it; numpy fills
        shorter texts with zero bytes."""
        self._objects = PlainObjects(namer or Namer())
        self._forms: dict[tuple[object, ...], str] = {}
        """The templates: lines with %s in place of each field that differs within a group. The key
        has the capture file, the MAC addresses and VLAN of both packets, and, as one number, the
        fields of the PDUs: unit, function, address, quantity and exception code."""
        self._order: list[str] = []
        """The names of the fields that differ within a group, in the order in which they stand in a
        line."""

    def batch(self, decoded: DecodedBlock) -> LineBatch:
        records = decoded.sorted_records()
        made = [one for _, one in records]
        rows = [(place, one) for place, one in records if not isinstance(one, WireEvent)]
        lines, order = [self._line_of(one) for _, one in rows], [place for place, _ in rows]
        plain = decoded.plain
        if plain is None:
            return LineBatch("".join(lines), Counter(), made)
        usual = UsualValues(plain)
        objects = self._objects.of(plain, usual)
        usual.is_usual &= ~objects.have_profile()
        forms, kinds = self._forms_of(plain, usual, objects)
        chosen, others = np.flatnonzero(usual.is_usual), np.flatnonzero(~usual.is_usual)
        unusual = [*objects.chosen(others)]
        usual_lines = self._lines(plain, usual, chosen, [forms[one] for one in kinds.tolist()])
        refused = int(np.count_nonzero(usual.exception[chosen] >= 0))
        outcomes = Counter({Outcome.OK: len(chosen) - refused, Outcome.EXCEPTION: refused})
        if not (lines or unusual):
            return LineBatch("".join(usual_lines), outcomes, made)
        places = result_sort_keys(plain.response)
        lines += [self._line_of(one) for one in unusual] + usual_lines
        places = np.concatenate([np.array(order, np.int64), places[others], places[chosen]])
        # Several rows may have one packet: they stay in their order.
        number = np.concatenate([np.arange(-len(order), 0), others, chosen])
        ordered = [lines[one] for one in np.lexsort((number, places)).tolist()]
        return LineBatch("".join(ordered), outcomes, [*made, *unusual], unusual)

    def _lines(
        self, rows: PlainRows, usual: UsualValues, chosen: Int64s, forms: list[str]
    ) -> list[str]:
        if not len(chosen):
            return []
        fields = self._fields(rows, usual, chosen)
        texts = zip(*(fields[name] for name in self._order), strict=True)
        return [form % some for form, some in zip(forms, texts, strict=True)]

    def _forms_of(
        self, rows: PlainRows, usual: UsualValues, objects: RowObjects
    ) -> tuple[list[str], Int64s]:
        """Return templates (lines with %s in place of each field that differs within a group), and
        for each usual row the index of its template.

        Rows of a group without a template that has fewer than MIN_TEMPLATE_ROWS rows in this block
        are no longer usual: to make a line of each is faster.
        """
        chosen = np.flatnonzero(usual.is_usual)
        numbers: dict[object, int] = {}
        place_of = np.array([numbers.setdefault(one, len(numbers)) for one in rows.addresses])
        places = [*numbers]
        asked = usual.asked[chosen]
        distinct, like = np.unique(asked, return_inverse=True)
        place = place_of[rows.connection[chosen]]
        _, first, kinds, counts = np.unique(
            place * len(distinct) + like,
            return_index=True,
            return_inverse=True,
            return_counts=True,
        )
        keys = [
            (rows.block.file, places[where], what)
            for where, what in zip(place[first].tolist(), asked[first].tolist(), strict=True)
        ]
        if len(self._forms) > MAX_LINES:
            self._forms.clear()
        is_new = np.array([key not in self._forms for key in keys], np.bool_)
        is_rare = is_new & (counts < MIN_TEMPLATE_ROWS)
        new = np.flatnonzero(is_new & ~is_rare)
        made = objects.chosen(chosen[first[new]])
        for one, example in zip(new.tolist(), made, strict=True):
            self._forms[keys[one]] = self._template(example)
        usual.is_usual[chosen[is_rare[kinds]]] = False
        return [self._forms.get(key, "") for key in keys], kinds[~is_rare[kinds]]

    def _template(self, like: NamedTransaction) -> str:
        """Return the line of the transaction `like` as a template: %s stands in place of each field
        that differs within a group.

        A field that this line lacks, such as the values written by a read, becomes %.0s, which
        prints nothing.
        """
        if not self._order:
            line = self._line_of(_with_marks(like, is_full=True))
            places = {name: line.index(_mark_of(name)) for name in (*_MARKS, *_TIMES)}
            self._order = sorted(places, key=places.__getitem__)
        line = self._line_of(_with_marks(like, is_full=False)).replace("%", "%%")
        for name in (*_NUMBERS, *_LISTS):
            # JSON puts a mark in quotes, as a text. Remove them, because a number takes its place.
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
        """Return for each field that differs within a group, by its name, a list with its text or
        number in each of the rows with the indices `chosen`.
        """
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
        """Return for each row its list of numbers as text, with separators between them. The text
        is empty if the row has no list.
        """
        padded = self._words[lists.numbers].view(np.uint8)
        text = padded[padded != 0].tobytes().decode()
        ends = np.concatenate([[0], np.cumsum(_WIDTHS[lists.numbers])])[lists.offsets]
        # Leave out the separator behind the last number of each row (transaction).
        stops = np.maximum(ends[1:] - 1, ends[:-1])
        return [
            text[begin:end] for begin, end in zip(ends[:-1].tolist(), stops.tolist(), strict=True)
        ]


class _HexMark:
    """Takes the place of a request's or response's raw bytes while a template is made: its
    hexadecimal text is the field's mark.
    """

    def __init__(self, name: str) -> None:
        self._name = name

    def hex(self) -> str:
        return _MARKS[self._name]


def _mark_of(name: str) -> str:
    if name == "time":
        return _MARK_TIME
    return str(_MARK_NS) if name == "request_ns" else _MARKS[name]


def _with_marks(like: NamedTransaction, *, is_full: bool) -> NamedTransaction:
    """Return the transaction `like` with a mark in each field that differs within a group.

    If `is_full`, a list of values that is None is replaced by a mark, too.
    """
    fields: dict[str, Any] = {name: _MARKS[name] for name in (*_TEXTS, *_NUMBERS)}
    fields |= {name: _HexMark(name) for name in _RAW}
    for name in _LISTS:
        if is_full or getattr(like, name) is not None:
            fields[name] = [_MARKS[name]]
    return msgspec.structs.replace(like, request_ns=_MARK_NS, **fields)


def _hex(rows: PlainRows, begins: Int64s, sizes: Int64s) -> list[str]:
    """Return many parts of `rows.data` as hexadecimal text: for each i, the `sizes[i]` bytes from
    the offset `begins[i]` on.
    """
    text = pieces(rows.data, begins, sizes).tobytes().hex()
    return [*_pieces(text, 2 * sizes)]


def _pieces(text: str, sizes: Int64s) -> Iterator[str]:
    ends = np.cumsum(sizes)
    for begin, end in zip((ends - sizes).tolist(), ends.tolist(), strict=True):
        yield text[begin:end]
