"""What CI servers need of a JUnit report."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from xml.etree.ElementTree import Element

_SECONDS = re.compile(r"\d+\.\d+")


def demand_junit(suite: Element) -> None:
    """Fail if a report breaks what the schemas of Jenkins and Ant, and GitLab's reader, demand.

    GitLab and Jenkins identify a case by classname and name, and drop or merge those that repeat.
    """
    assert suite.tag == "testsuite"
    assert suite.get("name") is not None
    cases = list(suite)
    assert {case.tag for case in cases} <= {"testcase"}
    counts = {kind: len(suite.findall(f"testcase/{kind}")) for kind in ("failure", "error")}
    assert [suite.get(key) for key in ("tests", "failures", "errors", "skipped")] == [
        str(len(cases)),
        str(counts["failure"]),
        str(counts["error"]),
        "0",
    ]
    assert len({(case.get("classname"), case.get("name")) for case in cases}) == len(cases)
    assert all(_SECONDS.fullmatch(each.get("time") or "") for each in (suite, *cases))
    for result in (each for case in cases for each in case):
        assert result.tag in ("failure", "error")
        assert result.get("message") is not None
        assert result.get("type")
    assert all(len(case) <= 1 for case in cases)
