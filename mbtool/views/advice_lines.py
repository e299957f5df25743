"""Says which requests of polled lists could be one."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from mbtool.core.moments import counted, duration
from mbtool.devices.references import write_reference
from mbtool.ledger.advice import Advised, CycleAdvice, Forecast, MergedRead
from mbtool.modbus import FUNCTIONS


def advice_lines(found: Sequence[Advised]) -> list[str]:
    """Return a line for each polled list, and one for each read that several could be."""
    lines = []
    for link, master, one in found:
        who = f"{link}, master {master}" if master else link
        if isinstance(one, CycleAdvice):
            lines.append(f"{who}: {_cycle_text(one)}")
            lines += [f"  {_merged_text(each)}" for each in one.merged]
        else:
            lines.append(f"{who}: {_forecast_text(one)}")
    return lines


def _forecast_text(one: Forecast) -> str:
    now_ns = one.busy_ns if one.waits else one.cycle_ns
    what = "the requests of a cycle take" if one.waits else "a cycle takes"
    faster = [f"at {baud} baud {duration(now_ns - less_ns)}" for baud, less_ns in one.at_bauds]
    more = f"with one unit more as the {'one' if one.units == 1 else one.units} of today"
    others = ", ".join([*faster, f"{more} {duration(now_ns + one.with_unit_ns)}"])
    return f"{what} {duration(now_ns)} at {one.baud} baud; {others}"


def _cycle_text(one: CycleAdvice) -> str:
    requests = f"{counted(one.requests, 'request')} can be {one.requests_then}"
    if one.waits:
        return (
            f"{requests}; they take {duration(one.busy_then_ns)} of each cycle of "
            f"{duration(one.cycle_ns)}, and not {duration(one.busy_ns)}"
        )
    return (
        f"{requests}; the cycle falls from {duration(one.cycle_ns)} to "
        f"{duration(one.cycle_then_ns)}"
    )


def _merged_text(one: MergedRead) -> str:
    table = FUNCTIONS[one.function].table
    assert table is not None
    span = write_reference(None, table, one.address, one.quantity)
    text = f"unit {one.unit}: {one.function:02X} {span} for {one.count} requests"
    if one.quantity > one.most_asked:
        text += f" (at most {one.most_asked} were asked at once so far: see its manual)"
    return text


def advice_document(found: Sequence[Advised]) -> list[dict[str, Any]]:
    """The advice for JSON."""
    return [
        _forecast_document(link, master, one)
        if isinstance(one, Forecast)
        else {
            "link": link,
            "master": master,
            "requests": one.requests,
            "requests_then": one.requests_then,
            "cycle_ms": one.cycle_ns / 1e6,
            "cycle_then_ms": one.cycle_then_ns / 1e6,
            "busy_ms": one.busy_ns / 1e6,
            "busy_then_ms": one.busy_then_ns / 1e6,
            "waits": one.waits,
            "reads": [
                {
                    "unit": each.unit,
                    "function": each.function,
                    "address": each.address,
                    "quantity": each.quantity,
                    "requests": each.count,
                    "most_asked": each.most_asked,
                }
                for each in one.merged
            ],
        }
        for link, master, one in found
    ]


def _forecast_document(link: str, master: str, one: Forecast) -> dict[str, Any]:
    now_ns = one.busy_ns if one.waits else one.cycle_ns
    return {
        "link": link,
        "master": master,
        "baud": one.baud,
        "cycle_ms": one.cycle_ns / 1e6,
        "busy_ms": one.busy_ns / 1e6,
        "waits": one.waits,
        "with_one_unit_more_ms": (now_ns + one.with_unit_ns) / 1e6,
        "at_other_bauds": [
            {"baud": baud, "ms": (now_ns - less_ns) / 1e6} for baud, less_ns in one.at_bauds
        ],
    }
