"""Results as JUnit XML, which CI servers show."""

# There is no standard of it; what Jenkins, GitLab and GitHub's actions all read is a testsuite of
# testcases, each with a failure where it failed. Characters that XML cannot have are replaced.

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from xml.etree import ElementTree

_NO_XML = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


@dataclass(frozen=True, slots=True)
class Case:
    """One thing that was tested."""

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
