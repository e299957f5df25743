from __future__ import annotations

import re

import pytest

from mbtool.views.report.contents import encoded
from mbtool.views.report.page import page
from tests.views.report.pages import Page, demand_self_contained

HOSTILE = (
    "</script><script>alert(1)</script>",
    "<!--<script>",
    "]]>",
    "<img src=x onerror=alert(1)>",
    "&lt;b&gt;",
    "\u2028\u2029\u202e",
    "\x1b[31m\x00",
    "\udc80",
    "{policy}{styles}{licence}</body>\n</html>\n",
)


def test_the_page_needs_nothing_from_elsewhere() -> None:
    demand_self_contained(Page(page("{}")))


@pytest.mark.parametrize("text", HOSTILE)
def test_no_text_becomes_markup(text: str) -> None:
    plain, hostile = Page(page(encoded({"a": ""}))), Page(page(encoded({"a": text})))
    assert hostile.document == {"a": text}
    assert hostile.tags == plain.tags
    assert [one for one in hostile.contents if one[0] != "application/json"] == [
        one for one in plain.contents if one[0] != "application/json"
    ]


def test_the_data_is_ascii_without_brackets() -> None:
    assert not re.search(r"[<>&]|[^\x00-\x7f]", encoded({"é<": ["</script>&", "\u2028"]}))


def test_the_script_makes_no_markup_of_texts() -> None:
    scripts = "".join(text for kind, text in Page(page("{}")).contents if kind == "script")
    for way in (
        "innerHTML",
        "outerHTML",
        "insertAdjacentHTML",
        "document.write",
        "eval(",
        "Function(",
    ):
        assert way not in scripts
    assert 'setAttribute("style"' not in scripts


def test_the_licence_of_the_charts_is_in_the_page() -> None:
    assert "Copyright (c) 2022 Leon Sorokin" in page("{}")
