"""Writes what `mbtool status` says of a log that a service records: as lines, and as JSON."""

from __future__ import annotations

import datetime
from collections.abc import Mapping
from typing import Any, NamedTuple

from mbtool.core.moments import counted

_DAY_S, _HOUR_S, _MINUTE_S = 86_400, 3600, 60


class RecordedLog(NamedTuple):
    """The facts about a log file that `mbtool sniff` writes."""

    path: str
    state: str
    size: int
    capture: Mapping[str, str]
    links: Mapping[str, str]
    heartbeat: Mapping[str, str]
    """The texts that the service last wrote into the log; empty for a log without them."""
    numbers: Mapping[str, int]
    """The counters that the service last wrote into the log; empty for a log without them."""
    now_ns: int


def status_lines(log: RecordedLog) -> list[str]:
    """Return a line for each known fact about a log."""
    capture = log.capture
    rows = [("log", f"{log.path}, {counted(log.size, 'byte', ',')}"), ("state", log.state)]
    if "part" in capture:
        rows.append(("part", capture["part"]))
    rows += [("host", capture.get("host", "")), ("command", capture.get("command", ""))]
    rows += [("link", f"{name}  {spec}".rstrip()) for name, spec in log.links.items()]
    if not log.heartbeat:
        rows.append(("counters", "none yet: only sniff --service writes them"))
    else:
        rows += _counters(log.heartbeat, log.numbers, log.now_ns)
    return [f"{name:<13}{text}" for name, text in rows if text]


def _counters(
    heartbeat: Mapping[str, str], numbers: Mapping[str, int], now_ns: int
) -> list[tuple[str, str]]:
    began_ns, at_ns = numbers.get("began_ns", 0), numbers.get("ts_ns", 0)
    transactions = _counters_text(numbers, "transactions.")
    events = _counters_text(numbers, "events.")
    waiting = numbers.get("waiting", 0)
    lost = [
        counted(numbers.get("lost_bytes", 0), "byte", ","),
        counted(numbers.get("lost_packets", 0), "packet", ","),
    ]
    return [
        ("since", f"{_utc(began_ns)}, for {_duration(at_ns - began_ns)}"),
        ("heartbeat", f"{_utc(at_ns)}, {_duration(now_ns - at_ns)} ago"),
        ("lost links", heartbeat.get("lost_links", "")),
        ("heard", f"{numbers.get('bytes', 0):,} bytes; the last at {_utc(numbers['last_ns'])}")
        if numbers.get("last_ns")
        else ("heard", "nothing until this heartbeat"),
        ("transactions", transactions or "none"),
        ("events", events),
        ("not recorded", ", ".join(lost)),
        ("not decoded", counted(waiting, "piece", ",") if waiting else ""),
    ]


def _counters_text(numbers: Mapping[str, int], prefix: str) -> str:
    """List the counters whose names begin with `prefix`, and leave the prefix out of the names.

    For `transactions.` this gives `1,200 ok, 3 no-answer`.
    """
    some = {key[len(prefix) :]: count for key, count in numbers.items() if key.startswith(prefix)}
    return ", ".join(f"{count:,} {name}" for name, count in some.items())


def status_document(log: RecordedLog) -> dict[str, Any]:
    """Return the facts about a log as JSON data for scripts; times are in ns since 1970.

    `age_s` is the time since the service last wrote its counters, in s.
    """
    document: dict[str, Any] = {"log": log.path, "state": log.state, "bytes": log.size}
    document |= {"capture": dict(log.capture), "links": dict(log.links)}
    if log.heartbeat:
        lost_links = log.heartbeat.get("lost_links", "").split()
        document["heartbeat"] = {**log.numbers, "lost_links": lost_links}
        document["age_s"] = round((log.now_ns - log.numbers.get("ts_ns", 0)) / 1e9, 3)
    return document


def _utc(ns: int) -> str:
    try:
        at = datetime.datetime.fromtimestamp(ns // 1_000_000_000, datetime.UTC)
    except (OverflowError, ValueError, OSError):
        return "unknown"
    return f"{at:%Y-%m-%d %H:%M:%S} UTC"


def _duration(ns: int) -> str:
    seconds = max(0, ns // 1_000_000_000)
    if seconds >= _DAY_S:
        return f"{seconds // _DAY_S} d {seconds % _DAY_S // _HOUR_S} h"
    if seconds >= _HOUR_S:
        return f"{seconds // _HOUR_S} h {seconds % _HOUR_S // _MINUTE_S} min"
    if seconds >= _MINUTE_S:
        return f"{seconds // _MINUTE_S} min {seconds % _MINUTE_S} s"
    return f"{seconds} s"
