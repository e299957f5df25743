"""Writes results as JUnit XML, which CI servers show."""

# The format has no standard. Jenkins, GitLab and GitHub actions all read a `testsuite` of
# `testcase` elements. A failed case has a `failure`; a case that could not be run has an `error`.
# Servers identify a case by `classname` and `name` together, so a name that occurs twice in a group
# gets a number. `time` is in seconds. Characters that XML does not allow are replaced.

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from xml.etree import ElementTree

_NO_XML = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


@dataclass(frozen=True, slots=True)
class Case:
    """One result: a test that passed, failed with messages, or could not be run."""

    group: str
    name: str
    failures: Sequence[str] = ()
    error: str | None = None
    """The reason why the test could not be run; None if it was run."""
    time_ns: int = 0
    """The duration of the test in ns."""


def junit_xml(suite: str, cases: Sequence[Case]) -> str:
    """Return a JUnit document with one testsuite; `suite` is its name."""
    root = ElementTree.Element(
        "testsuite",
        name=_text(suite),
        tests=str(len(cases)),
        failures=str(sum(bool(case.failures) for case in cases)),
        errors=str(sum(case.error is not None for case in cases)),
        skipped="0",
        # The schema of Jenkins allows at most three decimals here.
        time=f"{sum(case.time_ns for case in cases) / 1e9:.3f}",
    )
    for case, name in zip(cases, _names(cases), strict=True):
        element = ElementTree.SubElement(
            root, "testcase", classname=_text(case.group), name=name, time=_seconds(case.time_ns)
        )
        if case.error is not None:
            _add(element, "error", [case.error])
        if case.failures:
            _add(element, "failure", case.failures)
    ElementTree.indent(root)
    document: str = ElementTree.tostring(root, encoding="unicode")
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{document}\n'


def _add(element: ElementTree.Element, kind: str, messages: Sequence[str]) -> None:
    child = ElementTree.SubElement(element, kind, message=_text(messages[0]), type=kind)
    child.text = _text("\n".join(messages))


def _names(cases: Iterable[Case]) -> Iterator[str]:
    """Yield the names of the cases. A name that its group already has gets a number: `read (2)`."""
    taken: set[tuple[str, str]] = set()
    last: dict[tuple[str, str], int] = {}
    """The last number appended to a name, by group and name."""
    for case in cases:
        group, name = _text(case.group), _text(case.name)
        unique, number = name, last.get((group, name), 1)
        while (group, unique) in taken:
            number += 1
            unique = f"{name} ({number})"
        last[group, name] = number
        taken.add((group, unique))
        yield unique


def _seconds(ns: int) -> str:
    return f"{ns / 1e9:.6f}"


def _text(text: str) -> str:
    return _NO_XML.sub("\N{REPLACEMENT CHARACTER}", text)
