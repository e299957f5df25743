from __future__ import annotations

from xml.etree import ElementTree

from hypothesis import given
from hypothesis import strategies as st

from mbtool.views.junit import Case, junit_xml
from tests.views.junit_rules import demand_junit

TEXTS = st.text(max_size=20)


def test_a_failure_stands_in_its_case() -> None:
    cases = [
        Case("unit 1", "03 read holding", time_ns=1_500_000),
        Case("unit 1", "HR400001", ["7 became 8", "more"]),
        Case("link", "tcp:a:502", error="cannot be reached"),
    ]
    assert junit_xml("a.mcap", cases).splitlines() == [
        '<?xml version="1.0" encoding="UTF-8"?>',
        '<testsuite name="a.mcap" tests="3" failures="1" errors="1" skipped="0" time="0.002">',
        '  <testcase classname="unit 1" name="03 read holding" time="0.001500" />',
        '  <testcase classname="unit 1" name="HR400001" time="0.000000">',
        '    <failure message="7 became 8" type="failure">7 became 8',
        "more</failure>",
        "  </testcase>",
        '  <testcase classname="link" name="tcp:a:502" time="0.000000">',
        '    <error message="cannot be reached" type="error">cannot be reached</error>',
        "  </testcase>",
        "</testsuite>",
    ]


NAMES = TEXTS | st.sampled_from(["a", "a (2)", "a (2) (2)", "\x00", "\x01"])
CASES = st.builds(
    Case, NAMES, NAMES, st.lists(TEXTS, max_size=2), time_ns=st.integers(0, 10**15)
) | st.builds(Case, NAMES, NAMES, error=TEXTS)


@given(TEXTS, st.lists(CASES, max_size=6))
def test_any_text_is_xml_that_ci_servers_read(suite: str, cases: list[Case]) -> None:
    root = ElementTree.fromstring(junit_xml(suite, cases).encode())
    demand_junit(root)
    for kind, expected in (
        ("failure", [bool(one.failures) for one in cases]),
        ("error", [one.error is not None for one in cases]),
    ):
        assert [len(case.findall(kind)) for case in root] == expected


def test_a_name_that_repeats_gets_a_number() -> None:
    cases = [
        Case(group, name)
        for group, name in (("1", "a"), ("1", "a"), ("2", "a"), ("1", "a (2)"), ("1", "a"))
    ]
    root = ElementTree.fromstring(junit_xml("", cases))
    assert [case.get("name") for case in root] == ["a", "a (2)", "a", "a (2) (2)", "a (3)"]
