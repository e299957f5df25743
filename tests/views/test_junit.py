from __future__ import annotations

from xml.etree import ElementTree

from hypothesis import given
from hypothesis import strategies as st

from mbtool.views.junit import Case, junit_xml

TEXTS = st.text(max_size=20)


def test_a_failure_stands_in_its_case() -> None:
    cases = [Case("unit 1", "03 read holding"), Case("unit 1", "HR400001", ["7 became 8", "more"])]
    assert junit_xml("a.mcap", cases).splitlines() == [
        '<?xml version="1.0" encoding="UTF-8"?>',
        '<testsuite name="a.mcap" tests="2" failures="1" errors="0">',
        '  <testcase classname="unit 1" name="03 read holding" />',
        '  <testcase classname="unit 1" name="HR400001">',
        '    <failure message="7 became 8">7 became 8',
        "more</failure>",
        "  </testcase>",
        "</testsuite>",
    ]


@given(TEXTS, st.lists(st.builds(Case, TEXTS, TEXTS, st.lists(TEXTS, max_size=2)), max_size=4))
def test_any_text_is_xml(suite: str, cases: list[Case]) -> None:
    root = ElementTree.fromstring(junit_xml(suite, cases).encode())
    assert [len(case.findall("failure")) for case in root] == [bool(one.failures) for one in cases]
    assert root.get("failures") == str(sum(bool(one.failures) for one in cases))
