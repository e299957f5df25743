"""Writes findings (broken rules) as one document for programs: mbtool's JSON, or SARIF 2.1.0."""

# SARIF (OASIS, Static Analysis Results Interchange Format, 2.1.0) is a log with one run. The run
# lists the rules that have findings. A result has its rule, a message, and a location: the capture
# is the artifact; link, unit and reference are the logical location in it. SARIF has no field for a
# time, so the properties have it, in nanoseconds and as text.
#
# A document object returns the text of a document in pieces, one for each finding, and the caller
# writes them one after another. Memory: only the rules that have findings.

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol
from urllib.parse import quote

import msgspec

from mbtool.devices.checking.rules import rule_of
from mbtool.troubles.words import WORDS
from mbtool.views.tables import printable_json
from mbtool.views.trouble_lines import trouble_document, trouble_documents, trouble_text, utc_text

if TYPE_CHECKING:
    from mbtool.devices.checking.finding import Finding
    from mbtool.troubles.judge import Judgement
    from mbtool.troubles.trouble import Trouble

DOCUMENTATION = "docs/findings.md"
SARIF_SCHEMA = (
    "https://docs.oasis-open.org/sarif/sarif/v2.1.0/errata01/os/schemas/sarif-schema-2.1.0.json"
)


class Checked(NamedTuple):
    """The facts at the end of a document about the files that were checked."""

    transactions: int
    failed: Mapping[str, int]
    """The numbers of requests without a good answer, by what came."""
    judgement: Judgement
    remarks: Sequence[str] = ()
    """Lines for the user about the files."""
    is_whole: bool = True
    """False if a part of the files was not checked."""


class Document(Protocol):
    """Returns the text of a document in pieces: the beginning, each finding, and the end."""

    def begin(self) -> str: ...

    def add(self, finding: Finding, file: str) -> str: ...

    def end(self, checked: Checked) -> str: ...


class JsonDocument:
    """Writes mbtool's format: an object with `version`, `findings`, `rules` and counts."""

    def __init__(self, version: str) -> None:
        self._version = version
        self._rules: dict[str, Any] = {}
        self._joint = "\n"

    def begin(self) -> str:
        return f'{{"version":{_json(self._version)},"findings":['

    def add(self, finding: Finding, file: str) -> str:
        if finding.code not in self._rules:
            rule = {"severity": finding.severity.value, **_rule_texts(finding.code)}
            self._rules[finding.code] = rule
        joint, self._joint = self._joint, ",\n"
        return joint + _json({**_fields(finding), "file": file})

    def end(self, checked: Checked) -> str:
        rest = {
            "rules": self._rules,
            "transactions": checked.transactions,
            "failed_requests": checked.failed,
            **trouble_documents(checked.judgement),
            "is_whole": checked.is_whole,
            "remarks": list(checked.remarks),
        }
        return f"\n],{_json(rest)[1:]}\n"


class SarifDocument:
    """Writes SARIF 2.1.0: a log with one run, which holds all findings."""

    def __init__(self, version: str, paths: Mapping[str, str] | None = None) -> None:
        """`paths` has the path of each file whose name is shown otherwise, by the shown name."""
        self._version = version
        self._paths = paths or {}
        self._rules: dict[str, dict[str, Any]] = {}
        self._indices: dict[str, int] = {}
        self._joint = "\n"

    def begin(self) -> str:
        return f'{{"$schema":{_json(SARIF_SCHEMA)},"version":"2.1.0","runs":[{{"results":['

    def add(self, finding: Finding, file: str) -> str:
        if finding.code not in self._rules:
            self._indices[finding.code] = len(self._rules)
            self._rules[finding.code] = self._rule(finding)
        joint, self._joint = self._joint, ",\n"
        return joint + _json(
            _result(finding, self._paths.get(file, file), self._indices[finding.code])
        )

    def end(self, checked: Checked) -> str:
        driver = {
            "name": "mbtool",
            "version": self._version,
            "rules": list(self._rules.values()),
        }
        troubles = [one for one in checked.judgement.troubles if one.code in WORDS]
        results = "".join(self._trouble(one) for one in troubles)
        rest = {
            "tool": {"driver": driver},
            "invocations": [_invocation(checked)],
            "columnKind": "unicodeCodePoints",
            "properties": {
                "transactions": checked.transactions,
                "failed_requests": checked.failed,
            },
        }
        return f"{results}\n],{_json(rest)[1:-1]}}}]}}\n"

    def _trouble(self, one: Trouble) -> str:
        """Return a trouble as a result; the list of those that have it stands in its properties."""
        if one.code not in self._indices:
            self._indices[one.code] = len(self._rules)
            help_ = f"docs/troubles.md, section {one.code}"
            self._rules[one.code] = {
                "id": one.code,
                "shortDescription": {"text": one.code},
                "help": {"text": help_},
                "defaultConfiguration": {"level": one.words.severity.value},
            }
        joint, self._joint = self._joint, ",\n"
        place = "/".join([one.link, *([] if one.unit is None else [f"unit {one.unit}"])])
        location = {"name": one.who, "fullyQualifiedName": place, "kind": "resource"}
        return joint + _json(
            {
                "ruleId": one.code,
                "ruleIndex": self._indices[one.code],
                "level": one.severity.value,
                "message": {"text": trouble_text(one)},
                "locations": [{"logicalLocations": [location]}],
                "occurrenceCount": one.count,
                "properties": trouble_document(one),
            }
        )

    def _rule(self, finding: Finding) -> dict[str, Any]:
        rule = rule_of(finding.code)
        about = {"shortDescription": {"text": finding.code}}
        if rule is not None:
            help_ = f"{rule.meaning} Source: {rule.source}. {DOCUMENTATION}, section {rule.code}"
            about = {"shortDescription": {"text": rule.meaning}, "help": {"text": help_}}
        return {
            "id": finding.code,
            **about,
            "defaultConfiguration": {"level": finding.severity.value},
        }


def _result(finding: Finding, file: str, index: int) -> dict[str, Any]:
    return {
        "ruleId": finding.code,
        "ruleIndex": index,
        "level": finding.severity.value,
        "message": {"text": finding.message},
        "locations": [
            {
                "physicalLocation": {"artifactLocation": {"uri": _uri(file)}},
                "logicalLocations": [_logical(finding)],
            }
        ],
        "occurrenceCount": finding.count,
        "properties": _fields(finding),
    }


def _invocation(checked: Checked) -> dict[str, Any]:
    """Return SARIF's account of the run: whether all was checked, and the remarks on the files."""
    notes = [{"level": "warning", "message": {"text": remark}} for remark in checked.remarks]
    return {"executionSuccessful": checked.is_whole, "toolExecutionNotifications": notes}


def _logical(finding: Finding) -> dict[str, str]:
    """Return the logical location of a finding in SARIF's form, such as `LINK/unit 1/HR400001`.

    Unit and reference are left out if the finding has none. `name` is the last part of the
    location.
    """
    parts = [finding.link]
    if finding.unit is not None:
        parts.append(f"unit {finding.unit}")
    if finding.reference is not None:
        parts.append(finding.reference)
    return {"name": parts[-1], "fullyQualifiedName": "/".join(parts), "kind": "resource"}


def _fields(finding: Finding) -> dict[str, Any]:
    """Return the fields of a finding as a JSON object; fields that are None are left out."""
    fields = {
        "code": finding.code,
        "severity": finding.severity.value,
        "message": finding.message,
        "ts_ns": finding.ts_ns,
        "time": utc_text(finding.ts_ns),
        "link": finding.link,
        "source": finding.source,
        "destination": finding.destination,
        "unit": finding.unit,
        "function": finding.function,
        "reference": finding.reference,
        "device": finding.device,
        "count": finding.count,
        "packets": [*finding.packets] or None,
        "offsets": [*finding.offsets] or None,
        "cases": [[*packets] for packets in finding.cases] or None,
    }
    return {key: value for key, value in fields.items() if value is not None}


def _rule_texts(code: str) -> dict[str, str]:
    rule = rule_of(code)
    return {} if rule is None else {"meaning": rule.meaning, "source": rule.source}


def _uri(file: str) -> str:
    """Return a path as a relative or absolute URI reference; odd bytes are percent-encoded."""
    path = file.replace("\\", "/") if sys.platform == "win32" else file
    return quote(path.encode(errors="surrogateescape"))


def _json(value: Any) -> str:
    return printable_json(msgspec.json.encode(_without_surrogates(value)).decode())


def _without_surrogates(value: Any) -> Any:
    """Replace lone surrogates, which UTF-8 cannot encode, in all strings of JSON data.

    A file name that is not valid UTF-8 contains such surrogates.
    """
    if isinstance(value, str):
        return value.encode(errors="replace").decode()
    if isinstance(value, dict):
        return {key: _without_surrogates(one) for key, one in value.items()}
    return [_without_surrogates(one) for one in value] if isinstance(value, list) else value
