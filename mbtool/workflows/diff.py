"""Compares two captures or logs by their requests, responses, values and latencies."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import msgspec

from mbtool.core import InputError, WireEvent
from mbtool.devices import Difference, NamedTransaction, Profile, Span, parse_span
from mbtool.replay import Ignored, Traffic, differences
from mbtool.workflows.shared.read_all import Watch, read_all, unwatched
from mbtool.workflows.shared.reading import Reading, ReadingOptions


@dataclass(frozen=True, slots=True, kw_only=True)
class DiffOptions:
    """Options of a comparison of two captures: how they are read, and which of their transactions
    and values are compared.
    """

    reading: ReadingOptions
    wanted: Callable[[NamedTransaction], bool] = lambda _: True
    ignore: Sequence[str] = ()
    """Ranges of registers and bits whose values may differ, as texts such as `HR400001..400010` or
    `holding 0..9`."""
    latency: bool = True
    connections: bool = True
    """False if the beginnings and ends of TCP connections are not compared."""


class Comparison(msgspec.Struct, frozen=True, kw_only=True):
    """The result of comparing the captures `a` and `b`: their names, numbers of transactions, and
    differences.
    """

    a: str
    b: str
    a_transactions: int
    b_transactions: int
    a_compared: int
    """The number of transactions of `a` that were compared in every respect. It is less than
    `a_transactions` if there are more slaves, or requests or registers of a slave, than the memory
    limits of replay/traffic.py allow."""
    b_compared: int
    is_whole: bool
    """True if all transactions were compared in every respect."""
    differences: list[Difference]


def compare(
    a: str,
    b: str,
    options: DiffOptions,
    on_remark: Callable[[str], None] = lambda _: None,
    watch: Watch = unwatched,
) -> Comparison:
    """Read the files `a` and `b`, and compare them.

    A file that is cut or damaged is compared as far as it can be read. `on_remark` gets lines for
    the user about the files. `watch` passes on the records as they are read, and may show the
    progress. Raises InputError for a file that cannot be read or has no transaction, UsageError for
    a range in `options.ignore` that no device has.
    """
    traffic, profiles = [], dict[str, "Profile"]()
    for path in (a, b):
        reading = Reading([path], options.reading)
        read = _traffic(path, reading, options, on_remark, watch)
        if not read.count:
            raise InputError(f"{path}: no transaction to compare; see what it holds with decode")
        traffic.append(read)
        profiles |= {each.name: each for each in reading.assignments.profiles}
    ignored = Ignored(spans=_spans(options.ignore, profiles), latency=not options.latency)
    return Comparison(
        a=a,
        b=b,
        a_transactions=traffic[0].count,
        b_transactions=traffic[1].count,
        a_compared=traffic[0].compared,
        b_compared=traffic[1].compared,
        is_whole=all(each.compared == each.count for each in traffic),
        differences=differences(traffic[0], traffic[1], profiles, ignored),
    )


def _traffic(
    path: str,
    reading: Reading,
    options: DiffOptions,
    on_remark: Callable[[str], None],
    watch: Watch,
) -> Traffic:
    def say(remark: str) -> None:
        on_remark(remark if path in remark else f"{path}: {remark}")

    traffic = Traffic()
    for record in read_all(reading, say, "{error}; comparing what is there", watch):
        if isinstance(record, WireEvent):
            if options.connections:
                traffic.history.add_event(record)
        elif options.wanted(record):
            traffic.add(record)
    return traffic


def _spans(texts: Sequence[str], profiles: dict[str, Profile]) -> list[Span]:
    return [parse_span(text, profiles.values()) for text in texts]
