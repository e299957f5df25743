"""Kills recordings at random moments and looks at what is left: python -m tests.kills --moments N.

Each time `sniff` records a link on which this program sends, and is killed with SIGKILL. Then the
stock reader of MCAP must read the whole log, and `mbtool decode` must give every transaction that
was answered more than a second before, by the list of the sender. Ends with exit code 1 if not.
"""

# Rates go from 1 transaction a minute to 5,000 a second through a tap, and to 100 a second on a
# line (a pseudo-terminal). The table that `sniff` prints goes to a terminal that is read, to one
# that nobody reads, and to one that is closed meanwhile. Several recordings run at a time.

from __future__ import annotations

import argparse
import os
import random
import signal
import sys
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import cycle, islice, product
from pathlib import Path
from typing import TYPE_CHECKING

from tests.kills.senders import LineSender, TapSender, number_of
from tests.soak.accounts import count_messages, decoded
from tests.soak.plant import Terminal
from tests.soak.programs import Running, left_over, say

if TYPE_CHECKING:
    from collections.abc import Iterator

RATES = (1 / 60, 0.2, 1, 5, 20, 100, 500, 1000, 5000)
"""Transactions a second."""
FASTEST_LINE = 100
TERMINALS = ("read", "unread", "closed")
SECOND_NS = 1_000_000_000
OLD_S = 1.2
"""No recording is killed earlier: the first transaction must be older than a second."""


@dataclass(frozen=True)
class Moment:
    """How a recording runs, and how long until it is killed."""

    rate: float
    terminal: str
    is_line: bool
    after_s: float


@dataclass
class Result:
    """What was left of a recording."""

    moment: Moment
    old: int = 0
    """Transactions that were older than a second when it was killed."""
    sent: int = 0
    missing: int = 0
    newest_s: float = 0.0
    """How long before the kill the last transaction was answered that is in the log."""
    trouble: str = ""


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--moments", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--at-once", type=int, default=3)
    given = parser.parse_args()
    moments = list(islice(_moments(random.Random(given.seed)), given.moments))
    with ThreadPoolExecutor(given.at_once) as pool:
        results = [_told(one) for one in pool.map(_try, moments)]
    bad = [one for one in results if one.missing or one.trouble]
    say(f"{len(results)} recordings killed, load {os.getloadavg()[0]:.1f}")
    for rate in sorted({one.moment.rate for one in results}):
        some = [one for one in results if one.moment.rate == rate]
        say(
            f"  {rate:7.2f}/s: {len(some)} kills, {sum(one.old for one in some)} old transactions, "
            f"{sum(one.missing for one in some)} missing; the log reached to "
            f"{max(one.newest_s for one in some):.2f} s before the kill or nearer"
        )
    left = left_over()
    for process in left:
        say(f"a process is left: {process}")
    say("nothing is missing" if not bad and not left else f"{len(bad)} logs are not right")
    sys.exit(1 if bad or left else 0)


def _moments(chance: random.Random) -> Iterator[Moment]:
    # One at the slowest rate runs long enough for a second transaction.
    yield Moment(RATES[0], TERMINALS[0], is_line=False, after_s=62 + 10 * chance.random())
    for rate, terminal, is_line in cycle(product(RATES, TERMINALS, (False, True))):
        if not is_line or rate <= FASTEST_LINE:
            yield Moment(rate, terminal, is_line, OLD_S + chance.uniform(0, 3))


def _told(result: Result) -> Result:
    if result.missing or result.trouble:
        say(f"NOT RIGHT {result}")
    return result


def _try(moment: Moment) -> Result:
    result = Result(moment)
    try:
        with tempfile.TemporaryDirectory(prefix="kills-") as folder:
            _record_and_kill(result, Path(folder))
    except Exception as error:  # The others go on; this one is reported.
        result.trouble = f"{type(error).__name__}: {error}"
    return result


def _record_and_kill(result: Result, folder: Path) -> None:
    moment = result.moment
    log = folder / "killed.mcap"
    terminal = Terminal()
    if moment.terminal == "unread":
        terminal.is_read.clear()
    sender = LineSender(folder) if moment.is_line else TapSender()
    try:
        sniffer = Running("sniff", sender.link, "-w", str(log), stdout=terminal.far)
        os.close(terminal.far)
        sniffer.await_line("listening on")
        sender.begin(moment.rate)
        if moment.terminal == "closed":
            terminal.is_read.clear()
            os.close(terminal.near)
        time.sleep(moment.after_s)
        killed_ns = time.time_ns()
        sniffer.end(signal.SIGKILL)
    finally:
        answered = sender.stop()
    _judge(result, log, answered, killed_ns)


def _judge(result: Result, log: Path, answered: list[tuple[int, int]], killed_ns: int) -> None:
    """`answered` has the number and the time of each transaction."""
    count_messages(log)
    found = {
        number_of(bytes.fromhex(one["request_raw"]))
        for one in decoded([log])
        if "request_raw" in one and "response_raw" in one
    }
    result.sent = len(answered)
    old = [number for number, at_ns in answered if at_ns < killed_ns - SECOND_NS]
    result.old = len(old)
    result.missing = sum(number not in found for number in old)
    if not old:
        result.trouble = "no transaction was old enough"
    last_ns = max((at_ns for number, at_ns in answered if number in found), default=0)
    result.newest_s = max(0.0, (killed_ns - last_ns) / 1e9)


if __name__ == "__main__":
    main()
