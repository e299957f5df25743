"""Compares what a decoder makes of a capture with the truth."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import TYPE_CHECKING

from mbtool.decode.decoder import Decoder
from mbtool.devices import NamedTransaction, Namer
from mbtool.modbus import whole_pdu
from mbtool.modbus.adu import Verdict

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from mbtool.core import Packet
    from tests.adversary.network import Simulated
    from tests.adversary.truth import Truth

NO_ANSWER, UNSOLICITED = "no-answer", "unsolicited"
INVENTED = -1
"""The kind of an ADU that the capture does not have."""

Pair = tuple[int, int]


@dataclass(frozen=True, slots=True)
class Row:
    """A record with its kinds of ADUs; None where it has no request, or no response."""

    ask: int | None
    answer: int | None
    outcome: str
    is_sure: bool
    """False if the decoder says that another reading is about as good."""


@dataclass(frozen=True, slots=True)
class Judgement:
    """What is wrong with the records of one capture. Undecidable ADUs are in no list but theirs."""

    transactions: int
    """The pairs of the truth whose request and response are in the capture."""
    undecidable: int
    """How many of these cannot be known."""
    wrong: list[Pair]
    missing: list[Pair]
    blamed: list[int]
    unasked: list[int]
    excused: list[int]
    doubtful: int
    """Pairs that are told as ambiguous although they can be known."""

    def counts(self) -> dict[str, int]:
        return {
            "transactions": self.transactions,
            "undecidable": self.undecidable,
            "wrong": len(self.wrong),
            "missing": len(self.missing),
            "blamed": len(self.blamed),
            "unasked": len(self.unasked),
            "excused": len(self.excused),
            "doubtful": self.doubtful,
        }


def decode(packets: Iterable[Packet], ports: Sequence[int] = (502,)) -> list[NamedTransaction]:
    """The transactions of a capture, in the decoder's order."""
    decoder = Decoder(Namer(), ports=list(ports))
    records = [record for packet in packets for record in decoder.feed(packet)]
    records += decoder.close()
    return [record for record in records if isinstance(record, NamedTransaction)]


def judge(simulated: Simulated) -> Judgement:
    return judged(decode(simulated.packets), simulated.truth)


def judged(records: Sequence[NamedTransaction], truth: Truth) -> Judgement:
    """What is wrong with the transactions of a capture."""
    pairs = truth.pairs()
    return Judgement(
        transactions=pairs.total(),
        undecidable=sum(count for pair, count in pairs.items() if pair[1] in truth.unsure),
        wrong=wrong_pairs(records, truth),
        missing=missing_pairs(records, truth),
        blamed=blamed(records, truth),
        unasked=unasked(records, truth),
        excused=excused(records, truth),
        doubtful=doubtful(records, truth),
    )


def wrong_pairs(records: Iterable[NamedTransaction], truth: Truth) -> list[Pair]:
    """Pairs told as sure of which the truth says that they do not belong together."""
    joined = _joined(row for row in rows(records, truth) if row.is_sure)
    return [
        pair
        for pair in (joined - truth.pairs()).elements()
        if pair[0] not in truth.candidates.get(pair[1], ())
    ]


def missing_pairs(records: Iterable[NamedTransaction], truth: Truth) -> list[Pair]:
    """Pairs of the truth, both in the capture, that are not joined."""
    joined = _joined(rows(records, truth))
    return [
        pair for pair in (truth.pairs() - joined).elements() if not truth.unsure.intersection(pair)
    ]


def doubtful(records: Iterable[NamedTransaction], truth: Truth) -> int:
    """How many pairs are told as ambiguous whose response can be known to answer one request."""
    return sum(
        not row.is_sure and row.answer is not None and row.answer not in truth.unsure
        for row in rows(records, truth)
    )


def blamed(records: Iterable[NamedTransaction], truth: Truth) -> list[int]:
    """Requests that are told as not answered although the slave answered them."""
    told = Counter(
        row.ask
        for row in rows(records, truth)
        if row.outcome == NO_ANSWER and row.ask is not None and row.ask != INVENTED
    )
    return [one for one in (told - truth.unanswered()).elements() if one not in truth.unsure]


def unasked(records: Iterable[NamedTransaction], truth: Truth) -> list[int]:
    """Responses that are told as unsolicited although a request asked for them."""
    return [
        row.answer
        for row in rows(records, truth)
        if row.outcome == UNSOLICITED and row.answer is not None and row.answer not in truth.unsure
    ]


def excused(records: Iterable[NamedTransaction], truth: Truth) -> list[int]:
    """Requests that the slave dropped, told as something else though the capture is complete."""
    if not truth.is_complete:
        return []
    told = Counter(
        row.ask
        for row in rows(records, truth)
        if row.answer is None and row.outcome != NO_ANSWER and row.ask is not None
    )
    return [one for one in (told & truth.unanswered()).elements() if one not in truth.unsure]


def rows(records: Iterable[NamedTransaction], truth: Truth) -> list[Row]:
    """Find the kinds of the ADUs of records by their bytes and times.

    The truth has the ADUs that are wholly in the capture, so an ADU that is cut counts as absent.
    """
    ordered = list(records)
    requests = [(whole_adu(one, one.request_raw), one.request_ns) for one in ordered]
    responses = [(whole_adu(one, one.response_raw), one.response_ns) for one in ordered]
    asks = _kinds(requests, truth, is_ask=True)
    answers = _kinds(responses, truth, is_ask=False)
    return [
        Row(ask, answer, str(record.outcome), Verdict.AMBIGUOUS not in record.verdicts)
        for ask, answer, record in zip(asks, answers, ordered, strict=True)
    ]


def whole_adu(record: NamedTransaction, raw: bytes | None) -> bytes | None:
    """The bytes of an ADU; None if they are not all of it."""
    return None if whole_pdu(record.transport, raw) is None else raw


def _kinds(
    adus: list[tuple[bytes | None, int | None]], truth: Truth, *, is_ask: bool
) -> list[int | None]:
    """Each ADU takes a kind of its bytes and time that is not taken yet, in the records' order."""
    places = [
        truth.kinds_at(raw, ts_ns) if raw and ts_ns is not None else [] for raw, ts_ns in adus
    ]
    expected = Counter(kinds[0] for kinds in places if kinds)
    told: Counter[int] = Counter()
    found: list[int | None] = []
    for (raw, ts_ns), kinds in zip(adus, places, strict=True):
        if raw is None or ts_ns is None:
            found.append(None)
            continue
        free = [kind for kind in kinds if told[kind] < truth.sizes[kind]]
        held = truth.kind_before(raw, ts_ns, is_ask=is_ask, taken=told + expected)
        kind = next(iter([*free, *([] if held is None else [held]), *kinds]), INVENTED)
        told[kind] += 1
        found.append(kind)
    return found


def _joined(found: Iterable[Row]) -> Counter[Pair]:
    return Counter(
        (row.ask, row.answer) for row in found if row.ask is not None and row.answer is not None
    )
