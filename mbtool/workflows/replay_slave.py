"""Replays the slaves of a recording: answers requests with the recorded responses."""

from __future__ import annotations

import random
import re
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING

from mbtool.core import InputError, LinkSpec, SerialLink, TcpLink, UsageError
from mbtool.modbus import Responder, Response, Table, Transport
from mbtool.ports.tcp_listener import THIS_MACHINE, AllowedPeers
from mbtool.replay import (
    ConnectionPlayer,
    FixedLatency,
    LatencyModel,
    MatchStrategy,
    OnEnd,
    OnMiss,
    RecordedLatency,
    RecordedSlave,
    Recording,
    SampledLatency,
)
from mbtool.slave.device import RegisterImage
from mbtool.slave.device.responder import is_line
from mbtool.slave.families import make_device
from mbtool.slave.shells import OnExchange, Shell, open_shell, slave_link
from mbtool.workflows.shared.faults import faulty
from mbtool.workflows.shared.read_all import Watch, unwatched
from mbtool.workflows.shared.recorded import PlayOptions, Recorded, read_recorded, where_none

if TYPE_CHECKING:
    from collections import Counter

    from mbtool.devices import Profile
    from mbtool.replay import AnsweredFrom, Control, Progress, RequestKind
    from mbtool.slave.device.connection_policy import ConnectionPolicy

RECORDED, NONE, SAMPLED = "recorded", "none", "sampled"
_DURATION = re.compile(r"(\d{1,6}(?:\.\d{1,6})?)(us|ms|s)", re.ASCII)
MAX_LATENCY_NS = 1_000_000_000_000
"""The longest time (ns) that --latency accepts: 1000 s, longer than any master waits."""
_UNITS_NS = {"us": 1_000, "ms": 1_000_000, "s": 1_000_000_000}
_SEED = 0
"""The seed of the random numbers for `--latency sampled`. It is fixed, so that all runs draw the
same latencies."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SlaveOptions(PlayOptions):
    """The options for replaying a recording as the slave, which answers with the recorded
    responses.
    """

    match: MatchStrategy = MatchStrategy.AUTO
    on_miss: OnMiss = OnMiss.IMAGE
    on_end: OnEnd = OnEnd.LAST
    latency: str = RECORDED
    """The latency of responses, as text: `recorded`, `none`, `sampled`, or a time such as `5ms`."""
    with_damage: bool = False
    """True if the damaged responses of the recording are sent, too."""
    fault_file: Path | None = None


class SlaveRun:
    """Reads a recording, then answers a live master's requests with the recorded responses."""

    def __init__(
        self,
        path: str,
        options: SlaveOptions,
        on_remark: Callable[[str], None] = lambda _: None,
        watch: Watch = unwatched,
        *,
        recorded: Recorded | None = None,
        origin_ns: int | None = None,
    ) -> None:
        """Read the recording at `path`. If it is cut or damaged, use the part that can be read.

        `recorded` has the recording's transactions if the caller has already read the file.
        `on_remark` gets lines for the user about the file. --start and --end count from `origin_ns`
        (UTC ns), or from the first request if it is None. Raises InputError if the file cannot be
        read or has no request to answer. Raises UsageError if the options contradict each other or
        do not fit the recording.
        """
        if options.rate is None and options.match.by_clock:
            raise UsageError(
                f"--match {options.match} goes by the recording's clock, and --speed max has "
                "none; give --speed a number"
            )
        self._fixed_ns = _fixed_latency_ns(options.latency)
        self._options = options
        if recorded is None:
            recorded = read_recorded(path, options, on_remark, watch)
        events = recorded.damage if options.with_damage else ()
        self.recording = Recording.of(recorded.transactions, options.window, events, origin_ns)
        # Keep no reference to `recorded`: its transactions take several times the memory of
        # `self.recording`.
        self._profiles = recorded.assignments.profiles
        self._profile_of = _profile_of_units(recorded)
        self._connections = recorded.connections(options, origin_ns, on_remark)
        if not self.recording.answers:
            raise InputError(
                f"{path}: no request to play an answer for{where_none(options.window)}"
            )

    @property
    def profile_of(self) -> dict[int, Profile]:
        """The device profiles by unit; units without a profile are missing."""
        return dict(self._profile_of)

    def create_slave(
        self,
        link: LinkSpec,
        *,
        allowed: AllowedPeers = THIS_MACHINE,
        on_exchange: OnExchange | None = None,
        wrapped: Callable[[Responder], Responder] = lambda one: one,
    ) -> PlayedSlave:
        """Return the recording's slaves on a link, not yet started.

        Only masters in `allowed` may connect. `on_exchange` is called with each request and its
        response. `wrapped` gets the responder that answers, and returns the one to use in its
        place. Raises UsageError if no slave can answer on the link, or if the fault file is wrong;
        InputError if that file cannot be read.
        """
        where = slave_link(link)
        options = self._options
        devices = {}
        if options.match is MatchStrategy.AUTO:
            devices = {unit: RecordedDevice(one) for unit, one in self._profile_of.items()}
        slave = RecordedSlave(
            self.recording,
            match=options.match,
            on_miss=options.on_miss,
            on_end=options.on_end,
            rate=options.rate,
            latency=self._latency(),
            devices=devices,
            transport=_transport(where),
            with_damage=options.with_damage,
            any_unit=self._any_unit(where),
        )
        rules = None
        if isinstance(where, TcpLink) and not where.is_udp and self._connections:
            is_loop = options.on_end is OnEnd.LOOP
            rules = ConnectionPlayer(self._connections, rate=options.rate, is_loop=is_loop)
        responder: Responder = slave
        if options.fault_file is not None:
            responder = faulty(slave, options.fault_file, where, self._profiles)
        return PlayedSlave(
            slave,
            wrapped(responder),
            where,
            allowed=allowed,
            rules=rules,
            on_exchange=on_exchange,
        )

    def is_recorded(self, unit: int, pdu: bytes, link: LinkSpec) -> bool:
        """True if the recording has such a request to the unit, if it is sent on this link."""
        any_unit = self._any_unit(slave_link(link))
        if any_unit is not None and all(unit != asked for asked, _ in self.recording.answers):
            unit = any_unit
        return self.recording.has(unit, pdu)

    def _any_unit(self, where: SerialLink | TcpLink) -> int | None:
        """The recorded unit of a device that answers requests for any unit on this link."""
        if is_line(where):
            return None
        answers_any = (unit for unit, one in self._profile_of.items() if one.any_unit)
        return min(answers_any, default=None)

    def _latency(self) -> LatencyModel:
        if self._fixed_ns is not None:
            return FixedLatency(self._fixed_ns)
        if self._options.latency == SAMPLED:
            return SampledLatency(self.recording, random.Random(_SEED).random)
        return RecordedLatency(self.recording)


class PlayedSlave:
    """The slaves of a recording on a link.

    They answer in the thread of the link. Other threads may call `begin`, `counts`, `control` and
    `progress` at the same time.
    """

    def __init__(
        self,
        slave: RecordedSlave,
        responder: Responder,
        link: SerialLink | TcpLink,
        *,
        allowed: AllowedPeers,
        rules: ConnectionPolicy | None = None,
        on_exchange: OnExchange | None = None,
    ) -> None:
        self._slave = slave
        self._responder = responder
        self._lock = threading.Lock()
        self.before_request: Callable[[], None] = lambda: None
        """A function called in the link's thread before each request is answered; by default it
        does nothing."""
        self.shell: Shell = open_shell(
            link, self, allowed=allowed, rules=rules, on_exchange=on_exchange
        )

    def respond(self, unit: int, pdu: bytes, now_ns: int) -> Response | None:
        self.before_request()
        with self._lock:
            # `now_ns` is not used: this must be the same clock as for the user's keys.
            return self._responder.respond(unit, pdu, time.monotonic_ns())

    def begin(self) -> None:
        """Start the clock of the replay, unless it was started before."""
        with self._lock:
            self._slave.begin(time.monotonic_ns())

    def counts(self) -> Counter[AnsweredFrom]:
        """The number of requests so far, by what their responses were taken from, such as the
        recording.
        """
        with self._lock:
            return self._slave.answered_from.copy()

    def unrecorded(self) -> Counter[RequestKind]:
        """How often requests came that the recording does not have."""
        with self._lock:
            return self._slave.unrecorded.copy()

    def control(self, control: Control) -> None:
        """Carry out the command of a key that the user pressed: pause, step, faster or slower."""
        with self._lock:
            self._slave.control(control, time.monotonic_ns())

    def progress(self) -> Progress:
        with self._lock:
            return self._slave.progress(time.monotonic_ns())


class RecordedDevice:
    """A simulated device, made from its profile, that answers requests which the recording lacks.

    Before each request, the RecordedSlave sets the addressed registers to their recorded values.
    """

    def __init__(self, profile: Profile) -> None:
        self._image = RegisterImage.of(profile)
        self._device = make_device(profile, self._image)

    def learn(self, table: Table, address: int, value: int) -> None:
        self._image.set(table, address, [value])

    def respond(self, unit: int, pdu: bytes, now_ns: int) -> Response | None:
        return self._device.respond(unit, pdu, now_ns)


def _profile_of_units(recorded: Recorded) -> dict[int, Profile]:
    """The device profiles by unit; units without a profile are missing."""
    profiles: dict[int, Profile] = {}
    for transaction in recorded.transactions:
        profile = recorded.assignments.profile_for(transaction)
        if profile is not None:
            profiles.setdefault(transaction.unit, profile)
    return profiles


def _transport(link: SerialLink | TcpLink) -> Transport:
    if isinstance(link, SerialLink):
        return Transport.ASCII if link.ascii else Transport.RTU
    return Transport.at_endpoint(is_rtu=link.rtu, is_udp=link.is_udp)


def _fixed_latency_ns(text: str) -> int | None:
    """Parse the value of --latency. Returns a fixed latency in ns (0 for `none`); None for
    `recorded` and `sampled`, which are not fixed.

    Raises UsageError for any other text that is no time, and for a time above MAX_LATENCY_NS.
    """
    if text in (RECORDED, SAMPLED):
        return None
    if text == NONE:
        return 0
    match = _DURATION.fullmatch(text)
    if match is None:
        raise UsageError(
            f"--latency {text!r}: write {RECORDED}, {NONE}, {SAMPLED}, or a time such as 5ms"
        )
    latency_ns = int(Fraction(match[1]) * _UNITS_NS[match[2]])
    if latency_ns > MAX_LATENCY_NS:
        raise UsageError(f"--latency {text}: no master waits so long; write 1000s at most")
    return latency_ns
