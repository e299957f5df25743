"""Writing the screen to a terminal, or to what stands for one."""

from __future__ import annotations

import os
import sys
from typing import TYPE_CHECKING

import pytest

from mbtool.cli.watching.terminal_output import TerminalOutput, accept_any_byte

if sys.platform == "win32":
    pytest.skip("textual writes in another way there", allow_module_level=True)

import fcntl
import resource

from textual.drivers import linux_driver

if TYPE_CHECKING:
    from collections.abc import Iterator

FIRST = 1024
"""The first descriptor that `select.select` refuses."""


@pytest.fixture
def many_descriptors() -> Iterator[None]:
    before = resource.getrlimit(resource.RLIMIT_NOFILE)
    try:
        resource.setrlimit(resource.RLIMIT_NOFILE, (max(before[0], 2 * FIRST), before[1]))
    except (OSError, ValueError):
        pytest.skip("the system allows fewer descriptors")
    yield
    resource.setrlimit(resource.RLIMIT_NOFILE, before)


@pytest.mark.usefixtures("many_descriptors")
def test_a_descriptor_may_have_any_number() -> None:
    reading, writing = os.pipe()
    high = fcntl.fcntl(writing, fcntl.F_DUPFD, FIRST)
    os.close(writing)
    with os.fdopen(high, "w") as file:
        output = TerminalOutput(file, lambda: False)
        output.write("text")
    with os.fdopen(reading) as read:
        assert read.read() == "text"


def test_a_key_that_is_no_utf_8_is_an_unknown_key() -> None:
    accept_any_byte()
    assert linux_driver.getincrementaldecoder("utf-8")().decode(b"a\xfcb") == "a\ufffdb"  # type: ignore[attr-defined]
