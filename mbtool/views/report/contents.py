"""Collects what the report page shows into one JSON document for the script of the page."""

# In the document, the key `stats` has the output of `stats --json`, without the histograms of
# single polls, and of very many polls only those that were sent most often. The script makes tables
# and charts from it, so the figures of both are the same. The functions below describe the other
# keys.
#
# Bounds: MAX_UNITS units in charts over time, MAX_SAMPLES values in all charts of registers,
# MAX_POLLS polls for each link, MAX_ROWS rows in every other table.

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import TYPE_CHECKING, Any

import msgspec

from mbtool.core import WireEvent
from mbtool.devices import Difference
from mbtool.devices.checking.rules import Severity, rule_of
from mbtool.ledger.account import OTHER_UNITS, Account
from mbtool.ledger.advice import Advised
from mbtool.ledger.inventory_rows import InventoryDocument, Role, iso_time
from mbtool.ledger.time_bins import Chart, LinkSum, UnitSum
from mbtool.ledger.unit_account import UnitAccount, UnitKey
from mbtool.troubles.broken_rules import Summaries, where
from mbtool.troubles.judge import Judgement
from mbtool.troubles.words import WORDS
from mbtool.values.value_series import ValueSeries, thin_samples
from mbtool.values.values import Values
from mbtool.views.advice_lines import advice_lines
from mbtool.views.differences import what_text
from mbtool.views.inventory_table import mac_text, profile_text, seen_text, slave_lines
from mbtool.views.report.transaction_rows import TransactionRows
from mbtool.views.statistics_document import statistics_document
from mbtool.views.trouble_lines import trouble_text

if TYPE_CHECKING:
    from mbtool.devices.checking.finding import Finding
    from mbtool.ledger.distribution import Distribution
    from mbtool.ledger.statistics_report import LinkReport
    from mbtool.troubles.trouble import Trouble

MAX_UNITS = 24
MAX_SAMPLES = 40_000
LEAST_SAMPLES = 100
MOST_SAMPLES = 800
MAX_POLLS = 300
MAX_ROWS = 1000
MAX_CASES = 5
MAX_BINS = 300
REQUESTS_IN_BIN = 5
"""The bins of a chart have at least this many requests on average. In narrower bins a chart would
show single requests, as a comb; in much wider ones a capture of 100 requests would have only a few
bins."""
MAX_BARS = 200
"""Histograms beyond this have the coarse steps of `stats --json`."""
_FAILURES = {
    "no_answer": UnitSum.NO_ANSWER,
    "late": UnitSum.LATE,
    "exceptions": UnitSum.EXCEPTION,
    "retries": UnitSum.RETRIES,
    "bad_check": UnitSum.BAD_CHECK,
}
_NUMBER_BEGINS = "+-.0123456789"


@dataclass(frozen=True, slots=True)
class FileOrigin:
    """The facts that a capture file states about its recording, such as the host and the command.

    The mappings are empty for most files that another program wrote.
    """

    file: str
    capture: Mapping[str, str] = field(default_factory=dict)
    links: Mapping[str, Mapping[str, str]] = field(default_factory=dict)
    devices: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class ComparisonWith:
    """The differences from another capture that the user named."""

    other: str
    transactions: int
    other_transactions: int
    is_whole: bool
    differences: Sequence[Difference]


@dataclass(frozen=True, slots=True)
class ReportWords:
    """The user's own words on the page."""

    title: str = ""
    note: str = ""
    """A text for the reader of the page; a line end begins a paragraph."""
    where: str = ""
    """The filter of the transactions; empty if the page is about all of them."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ReportContents:
    """Everything that the report page is made from."""

    version: str
    made_ns: int
    sources: Sequence[str]
    account: Account
    judgement: Judgement
    late_ns: Mapping[UnitKey, int]
    """The latency (ns) from which an answer of a unit is late, for units with late answers."""
    inventory: InventoryDocument
    findings: Summaries
    number_of_findings: int
    values: Values
    rows: TransactionRows
    origins: Sequence[FileOrigin]
    remarks: Sequence[str]
    lacking: Sequence[WireEvent]
    """The first events that say what the capture lacks, such as lost packets."""
    number_lacking: int
    comparison: ComparisonWith | None = None
    words: ReportWords
    advice: Sequence[Advised] = ()


def report_document(contents: ReportContents) -> dict[str, Any]:
    """Return the document as JSON data.

    Texts from the wire are not escaped here: the page shows them as text nodes only.
    """
    bins = contents.account.bins.chart(
        min(contents.account.transactions // REQUESTS_IN_BIN, MAX_BINS)
    )
    return {
        "version": contents.version,
        "made": iso_time(contents.made_ns),
        "words": asdict(contents.words),
        "verdict": _verdict(contents.judgement),
        "stats": _statistics(contents),
        "advice": advice_lines(contents.advice),
        "bins": _bins(contents, bins),
        "bars": _bars(_sorted_links(contents), _places(contents)),
        "values": _values(contents.values, bins.begin_ns),
        "inventory": _inventory(contents),
        "findings": _findings(contents),
        "transactions": contents.rows.document(
            contents.late_ns,
            {
                each.ts_ns
                for one in contents.judgement.troubles
                if one.code == "POLL-PAUSED"
                for each in one.evidence
            },
        ),
        "capture": _capture(contents),
        "against": None if contents.comparison is None else _comparison(contents.comparison),
    }


def _verdict(judgement: Judgement) -> dict[str, Any]:
    """Return what is wrong: the first sentence of the page, and all troubles, the worst first.

    `others` are the units, links or masters that have the same trouble.
    """
    troubles = judgement.troubles
    sentence = judgement.summary
    if troubles:
        first = trouble_text(troubles[0])
        sentence = f"{first[:1].upper()}{first[1:]}."
    return {
        "level": judgement.level,
        "sentence": sentence,
        "troubles": [_trouble(one, is_told=not at) for at, one in enumerate(troubles[:MAX_ROWS])],
    }


def _trouble(one: Trouble, *, is_told: bool = False) -> dict[str, Any]:
    link = "" if " " in one.link else one.link
    place = " ".join(filter(None, [link, "" if one.unit is None else f"unit:{one.unit}"]))
    is_rule = one.code not in WORDS
    return {
        "text": trouble_text(one),
        "code": one.code,
        "severity": one.severity.value,
        "who": one.code if is_rule else one.who,
        "search": one.code if is_rule else " ".join(filter(None, [place, one.search])),
        "cases": [[each.ts_ns // 1000, each.text] for each in one.evidence[:MAX_CASES]],
        "cases_of": one.count,
        "is_rule": is_rule,
        "told": is_told,
        "others": [
            {"who": each.who, "text": each.cause, "search": _trouble(each)["search"]}
            for each in one.others[:MAX_ROWS]
        ],
    }


def _statistics(contents: ReportContents) -> dict[str, Any]:
    text = statistics_document(
        contents.account, contents.judgement, sources=contents.sources, where=None
    )
    document: dict[str, Any] = json.loads(text)
    # The keys `capture` and `verdict` have these.
    for key in ("is_whole", "remarks", "level", "troubles"):
        del document[key]
    names = _links_in_order(contents)
    document["links"].sort(key=lambda link: names.get(link["link"], len(names)))
    places = _places(contents)
    for link in document["links"]:
        name = link["link"]
        link["functions"].sort(key=lambda one: places.get((name, one["unit"]), len(places)))
        link["polls"] = sorted(
            sorted(link["polls"], key=lambda poll: -poll["transactions"])[:MAX_POLLS],
            key=lambda poll: poll["number"],
        )
        for poll in link["polls"]:
            (poll["latency"] or {}).pop("histogram", None)
    return document


def _bars(
    links: Sequence[LinkReport], places: Mapping[tuple[str, int | None], int]
) -> list[dict[str, Any]]:
    """Return the bars of latency histograms: of each link, and of each unit and function in it.

    `steps` has the begin and the end of each bar in ms, and its number of responses; `beyond` is
    the number of responses that took longer. `places` has the place of each unit on the page.
    """
    found: list[dict[str, Any]] = []
    for link in links:
        name = link.name
        functions = sorted(
            link.functions, key=lambda one: places.get((name, one.unit), len(places))
        )
        all_units: list[tuple[int | None, int | None, Distribution]] = [
            (None, None, link.tally.latency)
        ]
        all_units += [
            (None if one.unit == OTHER_UNITS else one.unit, one.function, one.tally.latency)
            for one in functions
        ]
        for unit, function, latency in all_units[: MAX_BARS - len(found)]:
            bars, beyond = latency.bars()
            found.append(
                {
                    "link": link.name,
                    "unit": unit,
                    "function": function,
                    "steps": [[bar.low_ns / 1e6, bar.high_ns / 1e6, bar.number] for bar in bars],
                    "beyond": beyond,
                }
            )
    return found


def _bins(contents: ReportContents, bins: Chart) -> dict[str, Any]:
    """Return counts over time: for each unit and link, lists with a number for each bin of time.

    `begin`, the beginning of the first bin, is in seconds since 1970; `width`, the width of each
    bin, is in seconds. `count` is the number of bins. `all` has the failures of all units that
    were counted, `counted` the number of these units.
    """
    timed = {link.name for link in contents.judgement.links if link.has_times}
    known = [unit for unit in _ordered_units(contents) if unit.key.link in timed]
    links = _sorted_links(contents)
    return {
        "begin": bins.begin_ns / 1e9,
        "width": bins.width_ns / 1e9,
        "count": bins.bins,
        "units_left_out": max(len(known) - MAX_UNITS, 0),
        "counted": len(known),
        "all": {name: _sums_of_bins(bins, known, place) for name, place in _FAILURES.items()},
        "units": [_unit_columns(bins, row) for row in known[:MAX_UNITS]],
        "links": [
            _link_columns(contents, bins, link) for link in links[:MAX_UNITS] if link.has_times
        ],
    }


def _ordered_units(contents: ReportContents) -> list[UnitAccount]:
    """Return the units in the one order that tables and charts of the page have: the sick ones, the
    worst first, then those with the most requests.
    """
    sick = {
        UnitKey(each.link, each.unit): -place
        for place, one in reversed([*enumerate(contents.judgement.troubles, 1)])
        for each in one.all
        if each.unit is not None
    }
    units = contents.account.units.values()
    return sorted(units, key=lambda row: (sick.get(row.key, -MAX_ROWS), *_rank(row)), reverse=True)


def _links_in_order(contents: ReportContents) -> dict[str, int]:
    """Return the place of each link in the order of its first unit."""
    names = dict.fromkeys(unit.key.link for unit in _ordered_units(contents))
    return {name: place for place, name in enumerate(names)}


def _sorted_links(contents: ReportContents) -> list[LinkReport]:
    names = _links_in_order(contents)
    return sorted(contents.judgement.links, key=lambda link: names.get(link.name, len(names)))


def _rank(unit: UnitAccount) -> tuple[int, int]:
    """Return the requests of a unit and its failures."""
    return unit.bins.total(UnitSum.REQUESTS), unit.bins.total(*_FAILURES.values())


def _sums_of_bins(bins: Chart, units: Sequence[UnitAccount], place: int) -> list[int]:
    """Return one sum of all these units for each bin."""
    added = [0] * bins.bins
    for unit in units:
        for at, number in enumerate(bins.column(unit.bins, place)):
            added[at] += number
    return added


def _unit_columns(bins: Chart, unit: UnitAccount) -> dict[str, Any]:
    def column(place: int) -> list[int]:
        return bins.column(unit.bins, place)

    sums, numbers = column(UnitSum.LATENCY_NS), column(UnitSum.LATENCIES)
    return {
        "link": unit.key.link,
        "unit": unit.key.unit,
        "requests": column(UnitSum.REQUESTS),
        **{name: column(place) for name, place in _FAILURES.items()},
        "mean_ms": [
            _ns_to_ms(total / number) if number else None
            for total, number in zip(sums, numbers, strict=True)
        ],
        "most_ms": [
            _ns_to_ms(most) if number else None
            for most, number in zip(column(UnitSum.GREATEST_NS), numbers, strict=True)
        ],
    }


def _ns_to_ms(ns: float) -> float:
    """Convert ns to ms, rounded to a microsecond."""
    return round(ns / 1e6, 3)


def _link_columns(contents: ReportContents, bins: Chart, link: LinkReport) -> dict[str, Any]:
    settings = contents.account.links[link.name]

    def column(place: int) -> list[int]:
        return bins.column(settings.bins, place)

    sizes = column(LinkSum.BYTES)
    load = None
    if link.load is not None:
        load = [round(min(settings.wire_ns(size) / bins.width_ns, 1.0), 4) for size in sizes]
    return {
        "link": link.name,
        "requests": column(LinkSum.REQUESTS),
        "bytes": sizes,
        "load": load,
        "bad_check": column(LinkSum.BAD_CHECK),
        "no_frame": column(LinkSum.NO_FRAME),
        "lacking": column(LinkSum.LACKING),
    }


def _values(values: Values, begin_ns: int) -> dict[str, Any]:
    """Return the values of registers and points for the page, as JSON data.

    A value that changed gives a series of samples, one that never changed only its last text. A
    sample is [ms since `begin_ns`, value]. If there are many series, each keeps fewer samples.
    """
    moving = {key: one for key, one in values.series.items() if one.changes and one.samples}
    most = min(max(MAX_SAMPLES // max(len(moving), 1), LEAST_SAMPLES), MOST_SAMPLES)
    return {
        "left_out": values.left_out,
        "series": [
            {
                "link": key.link,
                "unit": key.unit,
                "name": one.name,
                "reference": one.reference,
                "measure": one.unit,
                "kind": _drawing_kind(one),
                "changes": one.changes,
                "texts": [[value, text] for value, text in one.texts.items()],
                "samples": [
                    [(sample.ts_ns - begin_ns) // 1_000_000, sample.value]
                    for sample in thin_samples(one.samples, most)
                ],
            }
            for key, one in moving.items()
        ],
        "constant": [
            [key.link, key.unit, one.name, one.reference, _last_text(one)]
            for key, one in values.series.items()
            if key not in moving
        ],
    }


def _drawing_kind(series: ValueSeries) -> str:
    """Return the way in which the page draws a series of values: `bit`, `state` or `number`.

    A series is a state if the device's manual has words for its values.
    """
    if series.bit or (series.texts and {one.value for one in series.samples} <= {0, 1}):
        return "bit"
    are_words = any(text and text[0] not in _NUMBER_BEGINS for text in series.texts.values())
    return "state" if are_words else "number"


def _last_text(series: ValueSeries) -> str:
    if series.last_text:
        return series.last_text
    return f"{series.samples[-1].value:g} {series.unit}".strip() if series.samples else ""


def _places(contents: ReportContents) -> dict[tuple[str, int | None], int]:
    """Return the place of each unit, by link and unit, in the order of the page."""
    return {
        (one.key.link, one.key.unit): place for place, one in enumerate(_ordered_units(contents))
    }


def _inventory(contents: ReportContents) -> dict[str, Any]:
    document = contents.inventory
    quiet = (Role.SILENT, Role.UNHEARD)
    places = _places(contents)
    slaves = sorted(
        document.slaves,
        key=lambda row: (row.role in quiet, places.get((row.host, row.unit), len(places))),
    )
    return {
        "slaves": [
            {
                "where": row.where,
                "unit": row.unit,
                "role": row.role.value,
                "profile": profile_text(row),
                "transactions": row.transactions,
                "no_answer": row.unanswered - row.unreached,
                "unreached": row.unreached,
                "details": slave_lines(row),
            }
            for row in slaves[:MAX_ROWS]
        ],
        "slaves_seen": len(document.slaves),
        "masters": [
            [
                row.host,
                row.slaves,
                row.written,
                row.requests,
                seen_text(row.first_ns, row.last_ns),
                mac_text(row.macs, row.makers),
            ]
            for row in document.masters[:MAX_ROWS]
        ],
        "masters_seen": len(document.masters),
    }


def _findings(contents: ReportContents) -> dict[str, Any]:
    rows = []
    notes = 0
    for code, summary in contents.findings:
        rule = rule_of(code)
        places = summary.places()
        if summary.severity is Severity.NOTE:
            notes += sum(place.number for place in places) + summary.number_elsewhere
        for place in places:
            rows.append(
                {
                    "code": code,
                    "severity": summary.severity.value,
                    "meaning": "" if rule is None else rule.meaning,
                    "source": "" if rule is None else rule.source,
                    "place": place.place,
                    "count": place.number,
                    "first": _case(place.first),
                    "last": None if place.first is place.last else _case(place.last),
                    "elsewhere": summary.number_elsewhere,
                }
            )
    return {"broken": contents.number_of_findings - notes, "notes": notes, "rows": rows}


def _case(finding: Finding) -> dict[str, Any]:
    return {
        "us": finding.ts_ns // 1000,
        "message": finding.message,
        "where": where(finding),
        "source": finding.source or "",
    }


def _capture(contents: ReportContents) -> dict[str, Any]:
    return {
        "files": [
            {
                "file": one.file,
                "capture": list(one.capture.items()),
                "links": [[name, list(values.items())] for name, values in one.links.items()],
                "devices": list(one.devices.items()),
            }
            for one in contents.origins[:MAX_ROWS]
        ],
        "files_seen": len(contents.origins),
        "remarks": list(contents.remarks[:MAX_ROWS]),
        "lacking": [[one.ts_ns // 1000, one.link, one.message] for one in contents.lacking],
        "lacking_seen": contents.number_lacking,
    }


def _comparison(one: ComparisonWith) -> dict[str, Any]:
    return {
        "other": one.other,
        "transactions": one.transactions,
        "other_transactions": one.other_transactions,
        "is_whole": one.is_whole,
        "count": len(one.differences),
        "rows": [
            [
                f"unit {each.unit}" + ("" if each.link is None else f" on {each.link}"),
                each.kind.value,
                each.what,
                what_text(each),
                each.b.text,
                each.a.text,
            ]
            for each in one.differences[:MAX_ROWS]
        ],
    }


def encoded(document: dict[str, Any]) -> str:
    """Return the document as JSON for a script element.

    It is ASCII, and no text in it can end the element.
    """
    text = json.dumps(msgspec.to_builtins(document), ensure_ascii=True, separators=(",", ":"))
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")
