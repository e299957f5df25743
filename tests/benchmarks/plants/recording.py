"""The bytes of a line with the time of each, and the truth about every one of them."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum
from typing import TYPE_CHECKING

from mbtool.core import SerialFormat
from tests.benchmarks.plants.pdus import rtu_frame

if TYPE_CHECKING:
    from collections.abc import Callable
    from random import Random

START_NS = 1_700_000_000_000_000_000
MS = 1_000_000


class Role(StrEnum):
    """What some bytes of a line are."""

    REQUEST = "request"
    RESPONSE = "response"
    ECHO = "echo"
    """A frame heard again: the adapter hears what it sends, or a repeater sends what it hears."""
    NOISE = "noise"
    """Bytes that nobody sent."""


@dataclass(slots=True, kw_only=True)
class Sent:
    """One frame, or some bytes of noise, as it was on the wire."""

    role: Role
    raw: bytes
    offset: int
    """Its place in the bytes of the line."""
    start_ns: int
    end_ns: int
    """When the last bit of its last byte was sent."""
    answers: int | None = None
    """Of a response: the place of its request among all that was sent."""
    copies: int | None = None
    """Of an echo: the place of the request that is heard again."""
    is_retry: bool = False
    is_late: bool = False
    """A response that came after the master had given up and asked something else."""
    is_odd: bool = False
    """Of a response: it does not have the form of its function, or repeats something else."""
    is_damaged: bool = False
    """Noise that is left of a frame: the listener lost some of its bytes."""
    lacks_response: bool = False
    """Of a request: it got a response, which was not heard or is damaged."""

    @property
    def unit(self) -> int:
        return self.raw[0]

    @property
    def function(self) -> int:
        return self.raw[1]

    @property
    def is_exception(self) -> bool:
        return bool(self.raw[1] & 0x80)


@dataclass(slots=True)
class Recording:
    """What was on a line."""

    line: SerialFormat
    sent: list[Sent] = field(default_factory=list)
    data: bytearray = field(default_factory=bytearray)
    times: list[int] = field(default_factory=list)
    """When the last bit of each byte was sent."""
    timeout_ns: int = 0
    """How long the master waits before it repeats a request or gives up, 0 if it never did."""
    jitter_ns: int = 0
    """By how much that wait differs at most from one time to the next."""
    pause_ns: int = 0
    """The longest that the master waits between a response and the next request."""
    requests: int = 0

    def frames(self) -> list[int]:
        """The places of all frames but echoes of the adapter."""
        return [at for at, one in enumerate(self.sent) if one.role in (Role.REQUEST, Role.RESPONSE)]


def _no_glitch() -> tuple[bytes, bytes]:
    return b"", b""


class Bus:
    """A line on which somebody speaks; it keeps the time and the truth."""

    def __init__(self, line: SerialFormat, random: Random) -> None:
        self.recording = Recording(line)
        self.now_ns = START_NS
        self.echo_ns: int | None = None
        """After which time the adapter gives each request again; None: it does not."""
        self.repeat_ns: tuple[int, int] | None = None
        """The shortest and the longest time after which a repeater sends each frame again."""
        self.glitch: Callable[[], tuple[bytes, bytes]] = _no_glitch
        """Gives the bytes that a receiver makes of the edges before and behind a frame."""
        self.hesitates = 0.02
        """The share of the frames with a pause of up to t1.5 inside."""
        self.gapped = 0.0
        """The share of the frames with a gap of `gap_ms` inside."""
        self.gap_ms = (0, 0)
        self._random = random

    def wait(self, duration_ns: float) -> None:
        self.now_ns += max(0, int(duration_ns))

    def ask(self, unit: int, pdu: bytes, *, is_retry: bool = False) -> int:
        """Send a request; its place among all that was sent."""
        at = self._send(Role.REQUEST, rtu_frame(unit, pdu))
        self.recording.sent[at].is_retry = is_retry
        self.recording.requests += 1
        if self.echo_ns is not None:
            self.wait(self.echo_ns)
            self._copy(at)
        return self._repeated(at)

    def reply(self, request: int, pdu: bytes, *, is_late: bool = False) -> int:
        """Send the response to a request."""
        unit = self.recording.sent[request].unit
        at = self._send(Role.RESPONSE, rtu_frame(unit, pdu))
        self.recording.sent[at].answers = request
        self.recording.sent[at].is_late = is_late
        return self._repeated(at)

    def noise(self, data: bytes) -> None:
        self._send(Role.NOISE, data)

    def _repeated(self, at: int) -> int:
        if self.repeat_ns is not None:
            self.wait(self._random.randint(*self.repeat_ns))
            self._copy(at)
        return at

    def _copy(self, at: int) -> None:
        copy = self._send(Role.ECHO, self.recording.sent[at].raw)
        self.recording.sent[copy].copies = at

    def _send(self, role: Role, raw: bytes) -> int:
        before, behind = (b"", b"") if role is Role.NOISE else self.glitch()
        if before:
            self._put(Role.NOISE, before)
        at = self._put(role, raw)
        if behind:
            self._put(Role.NOISE, behind)
        return at

    def _put(self, role: Role, raw: bytes) -> int:
        recording, random = self.recording, self._random
        start_ns, offset = self.now_ns, len(recording.data)
        pauses_at = -1
        if role is not Role.NOISE and len(raw) > 1 and random.random() < self.hesitates:
            pauses_at = random.randrange(1, len(raw))
        gap_at = -1
        if self.gapped and len(raw) > 1 and random.random() < self.gapped:
            gap_at = random.randrange(1, len(raw))
        for at in range(len(raw)):
            if at == gap_at:
                self.now_ns += random.randint(*self.gap_ms) * MS
            if at == pauses_at:
                self.now_ns += random.randint(0, recording.line.t1_5_ns)
            self.now_ns += recording.line.character_ns
            recording.times.append(self.now_ns)
        recording.data += raw
        recording.sent.append(
            Sent(role=role, raw=raw, offset=offset, start_ns=start_ns, end_ns=self.now_ns)
        )
        return len(recording.sent) - 1
