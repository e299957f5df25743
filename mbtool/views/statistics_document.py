"""Writes statistics as one JSON document; docs/stats.md describes its keys."""

# Later versions may add keys, but never rename one or change its meaning. Each key names the unit
# of its figure. A figure that does not apply is null.

from __future__ import annotations

import json
from collections.abc import Sequence
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any

from mbtool.ledger.account import OTHER_UNITS, Account
from mbtool.ledger.distribution import PERCENTILES, Distribution
from mbtool.ledger.statistics_report import is_counted_together
from mbtool.modbus import Outcome
from mbtool.views.trouble_lines import trouble_documents

if TYPE_CHECKING:
    from mbtool.ledger.bus_load import BusLoad
    from mbtool.ledger.poll_cycle import PollList, PollLists
    from mbtool.ledger.poll_statistics import PollStatistics
    from mbtool.ledger.request_tally import RequestTally
    from mbtool.ledger.statistics_connections import ConnectionTally
    from mbtool.ledger.statistics_report import LinkReport, MasterReport, PollReport
    from mbtool.troubles.judge import Judgement

SCHEMA = 1

_COUNTED = (
    (Outcome.OK, "ok"),
    (Outcome.EXCEPTION, "exception"),
    (Outcome.LATE, "late"),
    (Outcome.NO_ANSWER, "no_answer"),
    (Outcome.NOT_CAPTURED, "not_captured"),
    (Outcome.UNSOLICITED, "unsolicited"),
    (Outcome.BROADCAST, "broadcast"),
    (Outcome.MALFORMED, "malformed"),
)


def statistics_document(
    account: Account,
    judgement: Judgement,
    *,
    sources: Sequence[str],
    where: str | None,
    remarks: Sequence[str] = (),
    is_whole: bool = True,
) -> str:
    """Return the document as JSON.

    `sources` are the files or links, `where` is the user's filter. `remarks` are lines for the user
    about the files. `is_whole` is False if a part of the files could not be read.
    """
    links = judgement.links
    document = {
        "schema": SCHEMA,
        "sources": list(sources),
        "where": where,
        "is_whole": is_whole,
        "remarks": list(remarks),
        "transactions": account.transactions,
        "polls_seen": account.polls_seen,
        "polls_listed": len(account.polls),
        "out_of_order": account.late,
        "watched_s": account.watched_ns / 1e9,
        "is_counted_together": is_counted_together(links),
        **trouble_documents(judgement),
        "links": [_link(link) for link in links],
    }
    return json.dumps(document, indent=2, ensure_ascii=True) + "\n"


def _link(link: LinkReport) -> dict[str, Any]:
    numbers = {id(one.poll): number for number, one in enumerate(link.polls)}
    return {
        "link": link.name,
        "transport": link.transport,
        "settings": link.settings,
        "has_times": link.has_times,
        "begin_ns": link.begin_ns if link.has_times else None,
        "end_ns": link.end_ns if link.has_times else None,
        "begin": _iso(link.begin_ns) if link.has_times else None,
        "end": _iso(link.end_ns) if link.has_times else None,
        "watched_s": link.watched_ns / 1e9,
        **_tally(link.tally, link),
        "repetitions": sum(one.repetitions for one in link.functions),
        "load": None if link.load is None else _load(link.load),
        "functions": [
            {
                "unit": None if one.unit == OTHER_UNITS else one.unit,
                "device": one.device,
                "function": one.function,
                "function_name": one.function_name,
                **_tally(one.tally, link),
                "repetitions": one.repetitions,
            }
            for one in link.functions
        ],
        "polls": [_poll(one, number, link) for number, one in enumerate(link.polls)],
        "masters": [_master(one, numbers) for one in link.masters],
        "connections": [_connections(master, one) for master, one in link.connections],
        "hours": [
            {"begin": _iso(one.begin_ns), "requests": one.requests, "no_answer": one.missing}
            for one in link.hours
        ],
    }


def _tally(tally: RequestTally, link: LinkReport) -> dict[str, Any]:
    return {
        "transactions": tally.transactions,
        "requests": tally.requests,
        "rate_per_s": link.rate(tally.requests),
        **{name: tally.count(outcome) for outcome, name in _COUNTED},
        "ambiguous": tally.ambiguous,
        "exceptions": [
            {"code": code, "name": tally.exception_names[code], "count": count}
            for code, count in sorted(tally.exceptions.items())
        ],
        "unsolicited_exceptions": tally.unsolicited_exceptions,
        "wrong_crc": tally.damaged,
        "retries": tally.retries,
        "request_bytes": tally.request_bytes,
        "response_bytes": tally.response_bytes,
        "latency": _latency(tally.latency),
    }


def _latency(latency: Distribution) -> dict[str, Any] | None:
    if not latency.count:
        return None
    return {
        "count": latency.count,
        "mean_ms": latency.mean / 1e6,
        "min_ms": latency.least / 1e6,
        **{f"p{one}_ms": latency.percentile(one) / 1e6 for one in PERCENTILES},
        "max_ms": latency.greatest / 1e6,
        "percentile_error": latency.error,
        "histogram": [
            {"from_ms": one.low_ns / 1e6, "below_ms": one.high_ns / 1e6, "count": one.number}
            for one in latency.histogram()
        ],
    }


def _load(load: BusLoad) -> dict[str, Any]:
    return {
        "busy_share": load.busy_share,
        "characters_share": load.share_of_time(load.spent.characters_ns),
        "other_bytes_share": load.share_of_time(load.other_ns),
        "slaves_share": load.share_of_time(load.spent.slaves_ns),
        "missing_share": load.share_of_time(load.spent.missing_ns),
        "pauses_share": load.share_of_time(load.pauses_ns),
    }


def _poll(one: PollReport, number: int, link: LinkReport) -> dict[str, Any]:
    key = one.poll.key
    return {
        "number": number,
        "master": key.master or None,
        "unit": key.unit,
        "device": one.poll.device,
        "function": key.function,
        "function_name": one.poll.function_name,
        "sub_function": key.sub_function,
        "address": key.address,
        "quantity": key.quantity,
        "write_address": key.write_address,
        "write_quantity": key.write_quantity,
        "reference": one.poll.reference,
        **_tally(one.poll.tally, link),
        "repetitions": one.poll.repetitions,
        "period": _period(one.poll),
        "load": _poll_load(one, link),
    }


def _period(poll: PollStatistics) -> dict[str, Any] | None:
    period = poll.period
    if not period.count or poll.jitter_ns is None:
        return None
    return {
        "count": period.count,
        "mean_ms": period.mean / 1e6,
        "min_ms": period.least / 1e6,
        "p5_ms": period.percentile(5) / 1e6,
        "p50_ms": period.percentile(50) / 1e6,
        "p95_ms": period.percentile(95) / 1e6,
        "max_ms": period.greatest / 1e6,
        "jitter_ms": poll.jitter_ns / 1e6,
        "percentile_error": period.error,
    }


def _poll_load(one: PollReport, link: LinkReport) -> dict[str, Any] | None:
    load, spent = link.load, one.line_time
    if load is None or spent is None:
        return None
    return {
        "characters_share": load.share_of_time(spent.characters_ns),
        "slaves_share": load.share_of_time(spent.slaves_ns),
        "missing_share": load.share_of_time(spent.missing_ns),
        "total_share": load.share_of_time(spent.total_ns),
    }


def _master(one: MasterReport, numbers: dict[int, int]) -> dict[str, Any]:
    lists: PollLists[PollStatistics] = one.lists
    return {
        "master": one.master or None,
        "requests_looked_at": one.requests,
        "response_timeout_ms": None if lists.timeout_ns is None else lists.timeout_ns / 1e6,
        "lists": [_list(each, numbers) for each in lists.lists],
        "between": [
            {"poll": numbers[id(poll)], "count": count}
            for poll, count in lists.between.items()
            if id(poll) in numbers
        ],
    }


def _list(one: PollList[PollStatistics], numbers: dict[int, int]) -> dict[str, Any]:
    return {
        "cycles": one.cycles,
        "other_cycles": one.other_cycles,
        "cycle_ms": one.period_ns / 1e6,
        "min_ms": one.times[0] / 1e6,
        "max_ms": one.times[-1] / 1e6,
        "without_missing_ms": None if one.whole_ns is None else one.whole_ns / 1e6,
        "with_missing_ms": None if one.missing_ns is None else one.missing_ns / 1e6,
        "asked_twice": sorted({numbers[id(poll)] for poll in one.repeated if id(poll) in numbers}),
        "steps": [
            {
                "poll": numbers.get(id(step.poll)),
                "pause_ms": step.pause_ns / 1e6,
                "took_ms": step.took_ns / 1e6,
                "cycles_with_missing": step.missing,
            }
            for step in one.steps
        ],
    }


def _connections(master: str, one: ConnectionTally) -> dict[str, Any]:
    return {
        "master": master or None,
        "opened": one.opened,
        "joined": one.joined,
        "refused": one.refused,
        "resets": one.resets,
        "closed": dict(sorted(one.closed.items())),
        "keep_alives": one.keep_alives,
        "unanswered_keep_alives": one.unanswered_keep_alives,
        "most_at_once": one.most_at_once,
    }


def _iso(ts_ns: int) -> str | None:
    """Return a time as 2026-11-22T09:14:03.201000+00:00; None outside the years 1 to 9999."""
    try:
        return datetime.fromtimestamp(ts_ns / 1e9, UTC).isoformat(timespec="microseconds")
    except (ValueError, OverflowError, OSError):
        return None
