"""Finds LINE-BIAS, LINE-FOREIGN and LINE-SETTINGS: bytes of a line that belong to no frame."""

# LINE-BIAS      One constant byte (00H, FFH, or another one), alone or twice, stands before or
#                after many frames: the idle line floats, or a driver switches too early or too
#                late. The trouble names these frames. If they are frames of all senders, bias is
#                missing. If they are frames of one sender, its driver switches at the wrong time.
# LINE-FOREIGN   Readable text, or pieces that all begin with the same two bytes, while most polls
#                are answered: another protocol shares the wires. A piece is a series of bytes that
#                is no frame.
# LINE-SETTINGS  For a while, or all the time, no frame has a correct CRC, but many other bytes are
#                on the line. If polls are answered before or after, the settings changed, or other
#                ones were used for that time. Settings are never called wrong while polls are
#                answered, nor because of readable text. On a line with many damaged frames several
#                may come in a row by chance, so a longer stretch is needed there.
#
# False alarms: a broken cable gives some stray bytes, but not MIN_STRETCH_BYTES of them. Noise
# damages some frames, but polls are answered in between. Foreign frames that are rare, or always
# different, are not recognised.
#
# Memory: a few numbers, the first bytes of HEADS pieces, and MAX_EVIDENCE cases of each kind, for
# each of at most MAX_LINKS links.

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from math import log
from typing import TYPE_CHECKING

from mbtool.core import EventKind, SerialFormat, WireEvent
from mbtool.core.moments import percent
from mbtool.devices.named_transaction import NamedTransaction
from mbtool.modbus import Outcome
from mbtool.troubles.sense import DAMAGE, MAX_LINKS, SortedSense, is_text
from mbtool.troubles.trouble import MAX_EVIDENCE, Evidence, Sureness, Trouble, keep

if TYPE_CHECKING:
    from mbtool.ledger.statistics_report import LinkReport

MIN_CASES = 5
"""The least number of constant bytes, or of pieces, from which a trouble is reported."""
MIN_BIAS_SHARE = 0.1
"""LINE-BIAS is reported only if there is at least this share (0 to 1) of a constant byte for each
transaction of the line."""
MIN_UNIT_SHARE = 0.1
"""LINE-BIAS names a unit if at least this share (0 to 1) of the constant bytes is beside its
frames."""
MIN_SAME_VALUE = 0.8
"""LINE-BIAS is reported only if at least this share (0 to 1) of the single bytes has the same
value."""
MIN_PLACE_SHARE = 0.2
"""LINE-BIAS names a place, such as before answers, if at least this share (0 to 1) of the constant
bytes is there."""
LONGEST_BIAS = 2
"""At most this many equal bytes count as bytes of an idle line; more are a piece."""
NEAR_NS = 4_000_000
"""A constant byte gets the place of the nearest frame if that begins or ends at most this long (ns)
from it. Farther away it gets no place, as the times of some adapters are too coarse."""
FOREIGN_BYTES = 50
"""LINE-FOREIGN is reported only if the pieces have at least this many bytes in all."""
MIN_FOREIGN_SHARE = 0.8
"""LINE-FOREIGN is reported if at least this share (0 to 1) of the pieces is readable text, or
begins with the same two bytes."""
SHORTEST_PIECE = 6
"""Shorter pieces (bytes) are not counted for LINE-FOREIGN."""
PIECE_NS = 50_000_000
"""A piece is taken for the rest of the piece before it, which an adapter or a pause has torn, if it
comes at most this long (ns) after it and no earlier piece begins with the same two bytes."""
HEADS = 64
"""At most this many different beginnings (two bytes) of pieces are counted for each line."""
MIN_STRETCH_BYTES = 100
"""LINE-SETTINGS needs a stretch without a correct frame of at least this many bytes."""
MIN_STRETCH_PIECES = 5
"""LINE-SETTINGS needs a stretch without a correct frame of at least this many pieces."""
SHORTEST_NS = 2_000_000_000
"""LINE-SETTINGS needs a stretch without a correct frame of at least this time (ns)."""
MAX_NOISE_CHANCE = 1e-6
"""LINE-SETTINGS needs a stretch whose pieces the line's usual noise would damage in a row with a
lower probability (0 to 1) than this."""
_ANSWERED = frozenset((Outcome.OK, Outcome.EXCEPTION, Outcome.LATE))


@dataclass(slots=True)
class _Stretch:
    """A time in which no frame had a right CRC."""

    first: WireEvent
    last_ns: int
    size: int = 0
    pieces: int = 0
    is_readable: bool = True


@dataclass(slots=True)
class _StrayLine:
    bias: Counter[bytes] = field(default_factory=Counter)
    waiting: list[WireEvent] = field(default_factory=list)
    """Single bytes whose place is not known yet."""
    places: Counter[tuple[str, int]] = field(default_factory=Counter)
    """The number of bytes at each place: before or after which frames, and of which unit."""
    bias_cases: list[Evidence] = field(default_factory=list)
    last: NamedTransaction | None = None
    text: int = 0
    """The number of pieces that are readable text."""
    text_bytes: int = 0
    pieces: int = 0
    piece_bytes: int = 0
    piece_ns: int | None = None
    """The time (ns) of the last piece; None if a frame came since."""
    heads: Counter[bytes] = field(default_factory=Counter)
    """The number of pieces, by the first two bytes of the piece."""
    own_heads: set[bytes] = field(default_factory=set)
    """The first two bytes of known frames: pieces that begin with the same bytes may be damaged
    frames."""
    foreign_cases: list[Evidence] = field(default_factory=list)
    read: int = 0
    """The number of bytes in frames."""
    unread: int = 0
    answered: int = 0
    requests: int = 0
    frames: int = 0
    """The number of transactions; each has at least one correct frame."""
    damaged: int = 0
    """The number of pieces that are no frame, outside of reported stretches."""
    stretch: _Stretch | None = None
    stretches: list[_Stretch] = field(default_factory=list)


class StrayBytes(SortedSense):
    """Finds LINE-BIAS, LINE-FOREIGN and LINE-SETTINGS."""

    def __init__(self, line_of: Callable[[str], SerialFormat | None]) -> None:
        """`line_of` returns the settings of a serial line by its name; None if unknown."""
        super().__init__()
        self._line_of = line_of
        self._lines: dict[str, _StrayLine] = {}

    def _line(self, link: str) -> _StrayLine | None:
        line = self._lines.get(link)
        if line is None and len(self._lines) < MAX_LINKS:
            line = self._lines[link] = _StrayLine()
        return line

    def take_event(self, event: WireEvent) -> None:
        if event.kind not in DAMAGE:
            return
        line = self._line(event.link)
        if line is None or not event.raw:
            return
        raw = event.raw
        line.unread += len(raw)
        if len(raw) <= LONGEST_BIAS and len(set(raw)) == 1:
            line.bias[raw[:1]] += 1
            if len(line.waiting) < MIN_CASES:
                line.waiting.append(event)
            keep(line.bias_cases, Evidence.of_event(event))
            return
        is_readable = is_text(raw)
        is_rest = line.piece_ns is not None and event.ts_ns - line.piece_ns <= PIECE_NS
        line.piece_ns = event.ts_ns
        if is_rest and not is_readable and raw[:2] not in line.heads:
            line.piece_bytes += len(raw)
        elif len(raw) >= SHORTEST_PIECE and event.kind is EventKind.SKIPPED:
            line.pieces += 1
            line.piece_bytes += len(raw)
            if is_readable:
                line.text += 1
                line.text_bytes += len(raw)
            if raw[:2] in line.heads or len(line.heads) < HEADS:
                line.heads[raw[:2]] += 1
            keep(line.foreign_cases, Evidence.of_event(event))
        if line.stretch is None:
            line.stretch = _Stretch(event, event.ts_ns)
        stretch = line.stretch
        stretch.last_ns = event.ts_ns
        stretch.size += len(raw)
        stretch.pieces += 1
        stretch.is_readable &= is_readable

    def take_transaction(self, one: NamedTransaction) -> None:
        if (line := self._line(one.link)) is None:
            return
        line.read += len(one.request_raw or b"") + len(one.response_raw or b"")
        line.requests += one.request_ns is not None
        if line.waiting:
            self._place(line, one)
        for raw in (one.request_raw, one.response_raw):
            if raw is not None and len(line.own_heads) < 4 * HEADS:
                line.own_heads.add(raw[:2])
        line.last = one
        line.answered += one.outcome in _ANSWERED
        line.frames += 1
        line.piece_ns = None
        _end_stretch(line)

    def _place(self, line: _StrayLine, after: NamedTransaction) -> None:
        """Note the place of the waiting single bytes: next to a frame of the transaction before
        them, or of the transaction `after`.
        """
        format_ = self._line_of(after.link)
        character_ns = 1_000_000 if format_ is None else format_.character_ns
        before = line.last
        for event in line.waiting:
            begin_ns, end_ns = event.ts_ns, event.ts_ns + len(event.raw) * character_ns
            distances: list[tuple[int, str, int]] = []
            if before is not None and before.request_ns is not None:
                distance = abs(begin_ns - before.request_ns)
                distances.append((distance, "behind requests", before.unit))
            if before is not None and before.response_ns is not None:
                begun_ns = before.response_ns - len(before.response_raw or b"") * character_ns
                distances.append((abs(begun_ns - end_ns), "before answers", before.unit))
                distance = abs(begin_ns - before.response_ns)
                distances.append((distance, "behind answers", before.unit))
            if after.request_ns is not None:
                begun_ns = after.request_ns - len(after.request_raw or b"") * character_ns
                distances.append((abs(begun_ns - end_ns), "before requests", after.unit))
            distance, place, unit = min(distances, default=(NEAR_NS + 1, "", 0))
            if distance <= NEAR_NS:
                line.places[place, unit] += 1
        line.waiting.clear()

    def troubles(self, links: Sequence[LinkReport]) -> Iterator[Trouble]:
        self.flush()
        for link in links:
            line = self._lines.get(link.name)
            if line is not None and link.is_whole:
                yield from _bias_troubles(link, line)
                yield from _foreign_troubles(link.name, line)
        for name, line in self._lines.items():
            yield from _settings_troubles(name, line)


def _bias_troubles(link: LinkReport, line: _StrayLine) -> Iterator[Trouble]:
    if not line.bias:
        return
    (byte, count), transactions = line.bias.most_common(1)[0], max(line.requests, 1)
    is_constant = count >= MIN_SAME_VALUE * line.bias.total()
    if count < MIN_CASES or count < MIN_BIAS_SHARE * transactions or not is_constant:
        return
    by_place: Counter[str] = Counter()
    for (place, _), number in line.places.items():
        by_place[place] += number
    total = by_place.total() or 1
    places = [
        place for place, number in by_place.most_common() if number >= MIN_PLACE_SHARE * total
    ]
    whose = (
        _units_beside(link, line, total)
        if all(place.endswith("answers") for place in places)
        else ""
    )
    where = f"{' and '.join(places)}{f' of {whose}' if whose else ''}" or "between frames"
    yield Trouble(
        code="LINE-BIAS", link=link.name, count=count, of=max(2 * transactions, count),
        figures={
            "byte": f"{byte.hex().upper()}H", "places": where, **_bias_words(places, whose),
        },
        sureness=Sureness.LIKELY, evidence=tuple(line.bias_cases),
    )  # fmt: skip


def _units_beside(link: LinkReport, line: _StrayLine, total: int) -> str:
    """Name the units beside whose frames the constant bytes stand; empty if they are all that
    answer.
    """
    by_unit: Counter[int] = Counter()
    for (_, unit), number in line.places.items():
        by_unit[unit] += number
    units = sorted(unit for unit, number in by_unit.items() if number >= MIN_UNIT_SHARE * total)
    answering = {one.unit for one in link.functions if one.tally.latency.count >= MIN_CASES}
    return " and ".join(f"unit {unit}" for unit in units) if answering - {*units} else ""


def _bias_words(places: Sequence[str], whose: str) -> dict[str, str]:
    """Say why a constant byte stands at these places, and what to do. `whose` names the units, if
    it stands beside frames of some only.

    Missing bias shows whenever the line is released, and so beside the frames of all senders; a
    driver that is switched at a wrong time, beside those of one.
    """
    senders = {place.rpartition(" ")[2] for place in places}
    if len(senders) != 1:
        return {
            "why": "the idle line floats, as bias is missing",
            "remedy": "fit bias resistors at one place of the line, and termination at both ends",
        }
    driver = f"the driver of {whose}" if whose else "a slave's driver"
    if senders == {"requests"}:
        driver = "the master's driver"
    times = {place.partition(" ")[0] for place in places}
    when = {"before": "on too early", "behind": "off too late"}
    how = " and ".join(when[time] for time in ("before", "behind") if time in times)
    return {
        "why": f"{driver} is switched {how}, or the line floats near it",
        "remedy": f"look at how {driver} is switched (its delays, or RTS of the adapter); if that "
                  "is right, fit bias resistors there",
    }  # fmt: skip


def _foreign_troubles(link: str, line: _StrayLine) -> Iterator[Trouble]:
    if line.pieces < MIN_CASES or line.piece_bytes < FOREIGN_BYTES:
        return
    if line.answered < MIN_CASES or line.answered < 0.5 * line.requests:
        return
    heads = Counter({head: n for head, n in line.heads.items() if head not in line.own_heads})
    head, alike = heads.most_common(1)[0] if heads else (b"", 0)
    count, size, form = line.text, line.text_bytes, "readable text"
    if line.text < MIN_FOREIGN_SHARE * line.pieces:
        if alike < MIN_FOREIGN_SHARE * line.pieces:
            return
        count, size, form = alike, line.piece_bytes, f"pieces that begin with {head.hex(' ')}"
    whole = line.read + line.unread
    yield Trouble(
        code="LINE-FOREIGN", link=link, count=count, of=0,
        figures={"share": percent(min(size / whole, 1)), "form": form, "answered":
                 percent(line.answered / line.requests)},
        sureness=Sureness.LIKELY, evidence=tuple(line.foreign_cases),
    )  # fmt: skip


def _settings_troubles(link: str, line: _StrayLine) -> Iterator[Trouble]:
    found = [*line.stretches]
    if line.stretch is not None and _is_wrong(line.stretch):
        found.append(line.stretch)
    pieces = line.damaged + sum(one.pieces for one in found)
    for one in found:
        if one.pieces < _chance_run_length(pieces - one.pieces, line.frames):
            continue
        whole = not line.answered
        when = "" if whole else f" for {(one.last_ns - one.first.ts_ns) / 1e9:.0f} s"
        yield Trouble(
            code="LINE-SETTINGS", link=link, count=one.pieces, of=one.pieces + line.frames,
            since_ns=None if whole else one.first.ts_ns,
            until_ns=None if whole or one is line.stretch else one.last_ns,
            figures={"bytes": f"{one.size:,}", "when": when},
            sureness=Sureness.LIKELY, evidence=(Evidence.of_event(one.first),),
        )  # fmt: skip


def _end_stretch(line: _StrayLine) -> None:
    stretch, line.stretch = line.stretch, None
    if stretch is None:
        return
    if _is_wrong(stretch) and len(line.stretches) < MAX_EVIDENCE:
        line.stretches.append(stretch)
    else:
        line.damaged += stretch.pieces


def _chance_run_length(damaged: int, right: int) -> float:
    """Return the number of damaged frames in a row that usual noise causes with the probability
    MAX_NOISE_CHANCE, on a line that has `damaged` and `right` frames in all.
    """
    return log(MAX_NOISE_CHANCE) / log(damaged / (damaged + right)) if damaged and right else 0


def _is_wrong(stretch: _Stretch) -> bool:
    is_long = stretch.last_ns - stretch.first.ts_ns >= SHORTEST_NS
    is_enough = stretch.size >= MIN_STRETCH_BYTES and stretch.pieces >= MIN_STRETCH_PIECES
    return is_long and is_enough and not stretch.is_readable
