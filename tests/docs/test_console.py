"""Every console block of README, docs and examples prints what stands there."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

from tests.docs.console import PAGES, steps
from tests.docs.normalising import NOT_RUN, agrees

ROOT = Path(__file__).parents[2]
LANGUAGES = {"console", "sh", "python", "text", "toml", "csv", "json", "yaml", "ini", "sql"}
FENCED = re.compile(
    r"^(?:<!-- console: (?P<words>[^\n]*?) -->\n)?"
    r"```(?P<language>\w*)[^\n]*\n(?P<body>.*?)^```$",
    re.MULTILINE | re.DOTALL,
)


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no pseudo-terminals")
def test_the_commands_of_the_pages_print_what_stands_there() -> None:
    # In a process of its own, without threads: it forks for each command.
    ran = subprocess.run(
        [sys.executable, "-m", "tests.docs.console"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert ran.returncode == 0, ran.stdout + ran.stderr


@pytest.mark.parametrize(
    ("page", "run", "is_equal"),
    [
        ("a\n", "a\n", True),
        ("a\n", "b\n", False),
        ("a\n", "a\nb\n", False),
        ("a\n...\n", "a\nb\nc\n", True),
        ("...\nc\n", "a\nb\nc\n", True),
        ("1 09:14:03.201    8.2  03 read -> 7\n", "1 23:00:59.999 120.4  03 read -> 7\n", True),
        ("1 09:14:03.201    8.2  03 read -> 7\n", "1 09:14:03.201    8.2  03 read -> 8\n", False),
        ("on 127.0.0.1:40219, 2026-11-22\n", "on 127.0.0.1:33833, 2027-01-02\n", True),
        ("exit code 1\n", "exit code 0\n", False),
    ],
)
def test_only_what_the_list_names_may_differ(page: str, run: str, is_equal: bool) -> None:
    assert agrees(page, run) == is_equal


def test_a_block_holds_commands_with_their_output_and_what_goes_on() -> None:
    found = steps("rest\n^C\n$ one \\\n  two\nout\n$ three\n")
    assert [(one.command, one.expected) for one in found] == [
        (None, "rest\n^C\n"),
        ("one \\\n  two", "out\n"),
        ("three", ""),
    ]


def test_a_block_of_commands_is_run_or_says_why_not() -> None:
    assert len(PAGES) > 30
    for page in PAGES:
        _demand_blocks_are_run(page.read_text())


def _demand_blocks_are_run(text: str) -> None:
    for block in FENCED.finditer(text):
        language, words = block["language"], block["words"] or ""
        assert language in LANGUAGES, block[0]
        if language == "sh" or words.startswith("not run"):
            assert words.removeprefix("not run: ") in NOT_RUN, block[0]
        if language == "text":
            assert not re.search(r"^(\$|mbtool) ", block["body"], re.MULTILINE), block[0]
    indented = re.findall(r"\n\n {4}\S.*", FENCED.sub("", text))
    assert indented == [], "a block stands between ```"


def test_each_reason_for_not_running_a_block_is_used() -> None:
    text = "".join(page.read_text() for page in PAGES)
    assert set(re.findall(r"^<!-- console: not run: (.*) -->$", text, re.MULTILINE)) == set(NOT_RUN)
