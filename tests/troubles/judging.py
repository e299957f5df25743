"""Judges records, or an account, without a capture file."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mbtool.ledger.account import Account
from mbtool.troubles.judge import Judge, Judgement
from tests.ledger.requests import LINE

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from mbtool.core import WireEvent
    from mbtool.devices.named_transaction import NamedTransaction
    from mbtool.ledger.statistics_report import LinkReport

NOTHING = Judgement((), ())


def judged(statistics: Account, links: Sequence[LinkReport] | None = None) -> Judgement:
    """The judgement over an account alone: without what senses and rules find."""
    return Judge(statistics).judgement(links)


def counted_of(records: Iterable[NamedTransaction | WireEvent]) -> Account:
    """The account of records of a serial line, or of a network, as a decoder returns them."""
    statistics = Account(lambda _: LINE)
    for record in records:
        statistics.add(record)
    statistics.settle()
    return statistics
