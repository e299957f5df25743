"""Holds what the plant sent against what the logs of a sniffer say.

Each transaction must be one of `Verdict`; MISSING and WRONG are failures.
"""

# A log is read twice: by the stock reader of MCAP, which must find no damage, and by `mbtool
# decode`, whose JSON lines are held against the plant's list by the bytes of request and response.
# With --raw the bytes are decoded anew; both ways are accounted.
#
# RTU frames may have two readings. On a busy machine this plant falls silent in the middle of a
# request, which may then be read as a response (OTHERWISE); docs/rs485.md.
#
# What a sniffer may lack, it has to tell: the time in which it did not run, the second before it
# was killed or its disk was full, the time between the `gap` events of a link, and
# what a `discarded` event counts.

from __future__ import annotations

import json
import subprocess
import sys
from collections import Counter, defaultdict
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mcap.reader import make_reader

from tests.soak.asked import NOISES, Asked, Touch

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

SECOND_NS = 1_000_000_000
UNPLUGGED_NS = SECOND_NS // 2
"""What the driver still held when a port was unplugged is lost with it."""
SHOWN = 5


class Verdict(StrEnum):
    """What became of a transaction in a log."""

    WHOLE = "in the log as it was"
    REQUEST_ONLY = "in the log, unanswered as it was"
    IN_PARTS = "of a flood, in the log, request and response not joined"
    OTHERWISE = "in the log, but the request is read as a response"
    DISTURBED = "damaged or behind noise on the line, in the log or not"
    TOLD = "told as lost: not running, killed, unplugged, discarded"
    BROKEN = "its connection broke before an answer"
    MISSING = "MISSING, and not told"
    WRONG = "WRONG in the log"


FAILURES = (Verdict.MISSING, Verdict.WRONG)


@dataclass(slots=True)
class Life:
    """One run of a sniffer, with its logs."""

    logs: list[Path]
    listening_ns: int
    """When it said that it listens; UTC ns, as all times."""
    ended_ns: int = 0
    is_killed: bool = False
    """True if it did not end in order: what it heard in its last second may be lost."""


@dataclass
class Accounts:
    """What a sniffer made of everything that the plant sent."""

    verdicts: dict[str, Counter[Verdict]] = field(default_factory=lambda: defaultdict(Counter))
    """By link."""
    failures: list[str] = field(default_factory=list)
    invented: list[str] = field(default_factory=list)
    """Whole transactions that nobody sent."""
    furthest_ns: int = 0
    """The largest difference between the time of a request here and in the log."""


class Told:
    """The times in which something may be missing from the logs of a sniffer."""

    def __init__(self, lives: list[Life], events: list[dict[str, Any]]) -> None:
        self._lives = lives
        self._spans: dict[str, list[tuple[int, int]]] = defaultdict(list)
        lost: dict[str, int] = {}
        for event in events:
            link, at_ns = event["link"], event["ts_ns"]
            if event["kind"] == "discarded":
                self._spans[link].append((at_ns - 2 * SECOND_NS, at_ns))
            elif event["kind"] == "gap" and "is back" in event["message"] and link in lost:
                self._spans[link].append((lost.pop(link) - UNPLUGGED_NS, at_ns))
            elif event["kind"] == "gap":
                lost.setdefault(link, at_ns)
        for link, at_ns in lost.items():
            self._spans[link].append((at_ns - UNPLUGGED_NS, 2**63))

    def covers(self, link: str, begin_ns: int, end_ns: int) -> bool:
        """True if something between these times may be missing."""
        heard = any(
            life.listening_ns <= begin_ns
            and end_ns <= life.ended_ns - (SECOND_NS if life.is_killed else 0)
            for life in self._lives
        )
        spans = (*self._spans[link], *self._spans[""])
        return not heard or any(begin_ns <= last and first <= end_ns for first, last in spans)


def events_of(records: list[dict[str, Any]], kinds: tuple[str, ...]) -> list[dict[str, Any]]:
    return [one for one in records if one.get("kind") in kinds]


def account(asked: Iterable[Asked], records: list[dict[str, Any]], told: Told) -> Accounts:
    """Compare what was sent with what was decoded."""
    accounts = Accounts()
    by_request: dict[str, list[dict[str, Any]]] = defaultdict(list)
    by_response: dict[str, list[dict[str, Any]]] = defaultdict(list)
    for record in records:
        if "outcome" in record:
            by_request[record.get("request_raw", "")].append(record)
            by_response[record.get("response_raw", "")].append(record)
    sent = set()
    noisy = []
    for one in asked:
        sent.add(one.request.hex())
        if one.touch in NOISES:
            noisy.append(one.sent_ns)
        verdict = _verdict(one, by_request[one.request.hex()], by_response, told, accounts)
        accounts.verdicts[one.link][verdict] += 1
        shown = sum(each.startswith(verdict) for each in accounts.failures)
        if verdict in FAILURES and shown < SHOWN:
            accounts.failures.append(f"{verdict}: {one} {by_request[one.request.hex()]}")
    for record in records:
        request = record.get("request_raw")
        is_sent = "outcome" not in record or request is None or request in sent
        if not is_sent and record["outcome"] in ("ok", "exception"):
            at_ns = record["request_ns"]
            if not any(abs(at_ns - noise_ns) < SECOND_NS for noise_ns in noisy):
                accounts.invented.append(str(record))
    return accounts


def _verdict(
    one: Asked,
    found: list[dict[str, Any]],
    by_response: dict[str, list[dict[str, Any]]],
    told: Told,
    accounts: Accounts,
) -> Verdict:
    near = [each for each in found if abs(each["request_ns"] - one.sent_ns) < 30 * SECOND_NS]
    for each in near:
        accounts.furthest_ns = max(accounts.furthest_ns, abs(each["request_ns"] - one.sent_ns))
    responses = [each.get("response_raw") for each in near]
    end_ns = one.answered_ns or one.sent_ns + SECOND_NS
    if one.response and one.response.hex() in responses:
        return Verdict.WHOLE
    if one.touch in NOISES:
        return Verdict.DISTURBED
    if near and not one.response:
        # A response that came too late for the master, or that it could not read, may be there.
        return Verdict.REQUEST_ONLY
    if told.covers(one.link, one.sent_ns, end_ns):
        return Verdict.TOLD
    if one.is_broken:
        return Verdict.BROKEN
    if by_response[one.request.hex()]:
        return Verdict.OTHERWISE
    if near and one.touch is Touch.FLOOD and by_response[one.response.hex()]:
        return Verdict.IN_PARTS  # docs/links.md: at most 256 requests wait for their responses.
    return Verdict.WRONG if near else Verdict.MISSING


def decoded(logs: list[Path], *options: str) -> Iterator[dict[str, Any]]:
    """The records of the logs of one life as `mbtool decode` gives them; --raw decodes anew.

    Raises RuntimeError if it fails.
    """
    command = [sys.executable, "-m", "mbtool", "decode", *map(str, logs), *options]
    done = subprocess.run(
        [*command, "--format", "jsonl", "--events", "all"],
        capture_output=True,
        text=True,
        check=False,
    )
    if done.returncode:
        raise RuntimeError(f"{command}: exit code {done.returncode}: {done.stderr}")
    return map(json.loads, done.stdout.splitlines())


def count_messages(log: Path) -> int:
    """Read a log with the stock reader; return how many messages it has. Raises its errors."""
    with log.open("rb") as stream:
        return sum(1 for _ in make_reader(stream, validate_crcs=True).iter_messages())
