"""What a listener cannot know of a line, whoever decodes it."""

# A place of the truth is doubtful where the bytes have a second reading that nothing in the capture
# makes clearly less likely. A decoder is right there if it tells the truth, and also if it calls
# the frame ambiguous. A place is hidden where even the doubt cannot be seen: two equal writes to
# a unit that usually answers are a write and its response, unless somebody knows better. Hidden
# places are not counted.
#
# What has a second reading is a run: frames in a row that each could answer the one before. They
# have equal bytes (05, 06, 08, 15H, 16H), or the same unit and a function whose form nobody knows.
#
# Without times:
#   - A unit that has responded before to something else is alive. An even run is what it seems:
#     requests with their responses; if the truth is another, it is hidden. An odd run is doubtful.
#   - Of a unit that was never heard, one frame is a request; each longer run is doubtful.
#
# With times, what parts both readings is the silence before each frame. It does not help where it
# is hidden by the resolution of the adapter's times, or where a response needs as long as the
# master's timeout, or before the line has shown how long its silences are.

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import groupby, pairwise
from typing import TYPE_CHECKING

from tests.benchmarks.plants.pdus import ECHOED
from tests.benchmarks.plants.recording import MS, Role

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from tests.benchmarks.plants.recording import Recording, Sent

KNOWN = frozenset((*range(0x01, 0x09), 0x0B, 0x0C, 0x0F, 0x10, 0x11, *range(0x14, 0x19), 0x2B))
LEARNT = 3
"""How often a line must have shown something before it is expected to be known."""
SHORT_RUN = 6
"""The most frames of an odd run that are all in doubt."""
FAR = 3
"""How many times longer a timeout must be than a latency or a pause to be told from it at once."""


@dataclass(slots=True)
class Unknowable:
    """Places of what was sent."""

    doubtful: set[int] = field(default_factory=set)
    hidden: set[int] = field(default_factory=set)


def unknowable(recording: Recording, resolution_ns: int | None) -> Unknowable:
    """What cannot be known; `resolution_ns` is that of the times, None if silences are hidden."""
    found = Unknowable()
    heard = _Heard()
    for run in _runs(recording):
        if len(run) > 1:
            if resolution_ns is None:
                _doubt_without_times(recording.sent, run, heard, found)
            else:
                _doubt_with_times(recording, run, heard, resolution_ns, found)
        heard.learn(recording.sent, run)
    _doubt_partners_of_damaged(recording, found)
    _hide_partners_of_lost(recording, found)
    _doubt_ends(recording, resolution_ns, found)
    _hide_learning(recording, found)
    return found


@dataclass(slots=True)
class _Heard:
    """What the line has shown so far."""

    alive: set[int] = field(default_factory=set)
    """Units that have sent a response that cannot be a request."""
    retries: int = 0
    """Those whose form tells that they are requests: they show the master's timeout."""
    responses: int = 0
    longest_ns: int = 0
    """The longest time until a response."""

    @property
    def timeout(self) -> bool:
        """True if the line has shown how long its master waits."""
        return self.retries >= LEARNT

    @property
    def pauses(self) -> bool:
        """True if the line has shown how long its master pauses."""
        return self.responses >= LEARNT

    def learn(self, sent: list[Sent], run: list[int]) -> None:
        for at in run:
            one = sent[at]
            self.retries += one.is_retry and len(run) == 1
            if one.role is Role.RESPONSE and one.answers is not None:
                self.responses += 1
                self.longest_ns = max(self.longest_ns, one.start_ns - sent[one.answers].end_ns)
                if len(run) == 1 and one.function & 0x7F in KNOWN:
                    self.alive.add(one.unit)


def _runs(recording: Recording) -> Iterator[list[int]]:
    """The frames of the line, joined where each could answer the one before."""
    sent = recording.sent
    for _, run in groupby(recording.frames(), key=_form(sent)):
        yield list(run)


def _form(sent: list[Sent]) -> Callable[[int], object]:
    def key(at: int) -> object:
        one = sent[at]
        if one.unit == 0 or one.is_exception:
            return at
        if one.function in ECHOED:
            return one.raw
        return at if one.function in KNOWN else (one.unit, one.function)

    return key


def _is_natural(sent: list[Sent], run: list[int]) -> bool:
    """True if the run is requests, each with its response behind it."""
    return len(run) % 2 == 0 and _deviation(sent, run) is None


def _deviation(sent: list[Sent], run: list[int]) -> int | None:
    """The first frame that is not what its place in the run lets one expect."""
    expected = (Role.REQUEST, Role.RESPONSE)
    roles = (sent[place].role for place in run)
    return next((at for at, role in enumerate(roles) if role is not expected[at % 2]), None)


def _doubt_without_times(
    sent: list[Sent], run: list[int], heard: _Heard, found: Unknowable
) -> None:
    if sent[run[0]].unit not in heard.alive:
        found.doubtful.update(run)
    elif not _is_natural(sent, run):
        if len(run) % 2 and len(run) <= SHORT_RUN:
            found.doubtful.update(run)
        else:
            first = _deviation(sent, run)
            found.hidden.update(run[first - 1 if first else 0 :])


def _doubt_with_times(
    recording: Recording, run: list[int], heard: _Heard, resolution_ns: int, found: Unknowable
) -> None:
    sent = recording.sent
    if not heard.pauses and not heard.timeout:
        found.doubtful.update(run)
        return
    for place, (before, at) in enumerate(pairwise(run)):
        if sent[at].role is Role.RESPONSE:
            gap_ns = sent[at].start_ns - sent[before].end_ns
            is_clear = _is_clearly_a_response(recording, gap_ns, heard, resolution_ns)
        else:
            after_response = sent[before].role is Role.RESPONSE
            is_clear = after_response or _is_clearly_a_retry(recording, heard, resolution_ns)
        if not is_clear:
            found.doubtful.update(run if len(run) <= SHORT_RUN else run[place:])


def _is_clearly_a_response(
    recording: Recording, gap_ns: int, heard: _Heard, resolution_ns: int
) -> bool:
    """True if it comes much sooner than a retry would, or at another time than a known one."""
    near_ns = _near_ns(recording, resolution_ns)
    is_soon = gap_ns * FAR + near_ns < recording.timeout_ns
    return is_soon or (heard.timeout and abs(gap_ns - recording.timeout_ns) > near_ns)


def _is_clearly_a_retry(recording: Recording, heard: _Heard, resolution_ns: int) -> bool:
    """True if the timeout is known, or much longer than all pauses and latencies of the line.

    Then a pause as long as the timeout, or a response that needed so long, would be the only one.
    """
    longest_ns = max(recording.pause_ns, heard.longest_ns)
    is_far = recording.timeout_ns > FAR * longest_ns + _near_ns(recording, resolution_ns)
    return heard.timeout or is_far


def _near_ns(recording: Recording, resolution_ns: int) -> int:
    """Two times that differ by less cannot be told apart."""
    return recording.jitter_ns + 2 * resolution_ns + 2 * MS


def _doubt_partners_of_damaged(recording: Recording, found: Unknowable) -> None:
    """A frame whose form does not tell its direction, if its partner, which would, is damaged."""
    sent = recording.sent
    for at, one in enumerate(sent):
        if one.role is Role.NOISE:
            continue
        partner_is_damaged = one.lacks_response or (
            one.answers is not None and sent[one.answers].is_damaged
        )
        is_clear = one.function & 0x7F in KNOWN and one.function not in ECHOED
        if partner_is_damaged and not is_clear:
            found.doubtful.add(at)


def _hide_partners_of_lost(recording: Recording, found: Unknowable) -> None:
    """A response that equals its request, if that request is lost as a whole."""
    sent = recording.sent
    if all(one.role is Role.RESPONSE for one in sent):
        return  # Only the slaves are heard: that tells the direction.
    for at, one in enumerate(sent):
        if one.role is Role.RESPONSE and one.answers is None and one.function in ECHOED:
            found.hidden.add(at)


def _doubt_ends(recording: Recording, resolution_ns: int | None, found: Unknowable) -> None:
    """A frame of an unknown function that ends in 00 is also right without it; see FACTS 6.5."""
    sent = recording.sent
    noisy = any(one.role is Role.NOISE for one in sent)
    for at, one in enumerate(sent):
        if one.role is Role.NOISE or one.function & 0x7F in KNOWN:
            continue
        after = sent[at + 1] if at + 1 < len(sent) else None
        longer = after is not None and after.role is Role.NOISE and after.raw[0] == 0
        if longer or (one.raw[-1] == 0 and (noisy or resolution_ns is None)):
            found.doubtful.add(at)


def _hide_learning(recording: Recording, found: Unknowable) -> None:
    """The first requests of an adapter that echoes: it has not been recognised yet."""
    echoes = [at for at, one in enumerate(recording.sent) if one.role is Role.ECHO]
    if not echoes:
        return
    last = echoes[min(LEARNT, len(echoes)) - 1]
    found.hidden.update(
        at
        for at, one in enumerate(recording.sent)
        if at <= last or (one.answers is not None and one.answers <= last)
    )
