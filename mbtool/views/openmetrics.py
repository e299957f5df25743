"""Writes the counts of live links as OpenMetrics, for Prometheus; docs/service.md lists them."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

from mbtool.ledger.account import OTHER_UNITS
from mbtool.ledger.distribution import PERCENTILES
from mbtool.views.tables import printable

if TYPE_CHECKING:
    from mbtool.troubles.judge import Judgement


def openmetrics(judgement: Judgement) -> str:
    """Return the metrics of all links as text, with the end mark."""
    families = (
        ("mbtool_transactions", "counter", "Transactions by outcome.", _transactions(judgement)),
        ("mbtool_latency_seconds", "summary", "From request to response.", _latencies(judgement)),
        ("mbtool_bus_busy_ratio", "gauge", "Share of the time with characters.", _busy(judgement)),
        ("mbtool_trouble", "gauge", "1 for each trouble; docs/troubles.md.", _troubles(judgement)),
    )
    lines = []
    for name, kind, about, samples in families:
        lines += [f"# TYPE {name} {kind}", f"# HELP {name} {about}", *samples]
    return "\n".join([*lines, "# EOF\n"])


def _transactions(judgement: Judgement) -> Iterator[str]:
    for link in judgement.links:
        for one in link.functions:
            labels = {"link": link.name, "unit": _unit(one.unit), "function": f"{one.function:02X}"}
            for outcome, number in sorted(one.tally.outcomes.items()):
                yield _sample(
                    "mbtool_transactions_total", {**labels, "outcome": outcome.value}, number
                )


def _latencies(judgement: Judgement) -> Iterator[str]:
    for link in judgement.links:
        for one in link.functions:
            labels = {"link": link.name, "unit": _unit(one.unit), "function": f"{one.function:02X}"}
            latency = one.tally.latency
            if latency.count:
                for percent in PERCENTILES:
                    value = latency.percentile(percent) / 1e9
                    quantile = {**labels, "quantile": str(percent / 100)}
                    yield _sample("mbtool_latency_seconds", quantile, value)
                yield _sample("mbtool_latency_seconds_count", labels, latency.count)
                yield _sample("mbtool_latency_seconds_sum", labels, latency.total / 1e9)


def _busy(judgement: Judgement) -> Iterator[str]:
    for link in judgement.links:
        if link.load is not None:
            yield _sample("mbtool_bus_busy_ratio", {"link": link.name}, link.load.busy_share)


def _troubles(judgement: Judgement) -> Iterator[str]:
    seen = set()
    for one in judgement.troubles:
        for each in one.all:
            labels = {
                "code": each.code, "severity": each.severity.value, "link": each.link,
                "unit": "" if each.unit is None else str(each.unit), "master": each.master,
            }  # fmt: skip
            if (key := tuple(labels.values())) not in seen:
                seen.add(key)
                yield _sample("mbtool_trouble", labels, 1)


def _unit(unit: int) -> str:
    return "other" if unit == OTHER_UNITS else str(unit)


def _sample(name: str, labels: dict[str, str], value: float) -> str:
    texts = ",".join(f'{key}="{_escaped(text)}"' for key, text in labels.items())
    return f"{name}{{{texts}}} {value!r}"


def _escaped(text: str) -> str:
    return printable(text).replace("\\", "\\\\").replace('"', '\\"').replace("\n", "\\n")
