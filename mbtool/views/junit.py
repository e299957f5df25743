"""Writes results as JUnit XML, which CI servers show."""

# The format has no standard. Jenkins, GitLab and GitHub actions all read a `testsuite` of
# `testcase` elements, in which failed ones have a `failure`. Characters that XML does not allow are
# replaced.

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from xml.etree import ElementTree

_NO_XML = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


@dataclass(frozen=True, slots=True)
class Case:
    """One result: a test that passed, or failed with messages."""

    group: str
    name: str
    failures: Sequence[str] = ()


def junit_xml(suite: str, cases: Sequence[Case]) -> str:
    """A document with one testsuite."""
    failed = sum(bool(case.failures) for case in cases)
    root = ElementTree.Element(
        "testsuite", name=_text(suite), tests=str(len(cases)), failures=str(failed), errors="0"
    )
    for case in cases:
        element = ElementTree.SubElement(
            root, "testcase", classname=_text(case.group), name=_text(case.name)
        )
        if case.failures:
            failure = ElementTree.SubElement(element, "failure", message=_text(case.failures[0]))
            failure.text = _text("\n".join(case.failures))
    ElementTree.indent(root)
    document: str = ElementTree.tostring(root, encoding="unicode")
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{document}\n'


def _text(text: str) -> str:
    return _NO_XML.sub("\N{REPLACEMENT CHARACTER}", text)
