"""Running before others, where that is permitted."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from mbtool.sources import child

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="Linux only")

ASK = """
import os, threading
from mbtool.sources.child import run_promptly
run_promptly()
policies = [os.sched_getscheduler(0)]
thread = threading.Thread(target=lambda: policies.append(os.sched_getscheduler(0)))
thread.start()
thread.join()
print(*policies, os.sched_getparam(0).sched_priority)
"""


def test_a_process_asks_for_itself_alone_and_for_the_least() -> None:
    answer = subprocess.check_output([sys.executable, "-c", ASK], text=True)
    process, thread, rank = map(int, answer.split())
    assert (process & ~os.SCHED_RESET_ON_FORK, rank) in [(os.SCHED_RR, 1), (os.SCHED_OTHER, 0)]
    assert thread == os.SCHED_OTHER


def test_what_is_not_permitted_changes_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise PermissionError

    monkeypatch.setattr(os, "sched_setscheduler", refuse)
    before = os.sched_getscheduler(0)
    child.run_promptly()
    assert os.sched_getscheduler(0) == before
