"""The base of the slaves for Python programs: it answers on a link and records the requests."""

# The slave's thread hands each request over before its response leaves. So once a master has a
# response, the request is in `asked`.
#
# Memory: at most MAX_KEPT requests; older ones are dropped.

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import cached_property
from os import fspath
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

from mbtool.core import LinkError, LinkSpec, SerialLink, TcpLink, UsageError, WireEvent, parse_link
from mbtool.core.link_spec import ANSWERED
from mbtool.core.moments import clock_time
from mbtool.devices import NamedTransaction, Profile, Span, find_span
from mbtool.modbus import FUNCTIONS, Outcome, Responder
from mbtool.modbus.functions import READ_WRITE_REGISTERS
from mbtool.slave.device.value_targets import ValueTarget, ValueTargets
from mbtool.slave.shells import Shell, TcpSlave, UdpSlave, slave_link
from mbtool.views.cells import event_text, transaction_text
from mbtool.workflows.shared.faults import FaultSwitch
from mbtool.workflows.shared.slave_monitor import SlaveMonitor

if TYPE_CHECKING:
    from mbtool.api.arguments import AnyPath
    from mbtool.decode.decoder import Record

MAX_KEPT = 100_000
"""At most this many requests are kept; a test that polls for an hour at 20 a second makes
72,000."""
_SHOWN = 20
"""The message of a failed assertion shows at most this many requests."""


class ObservedShell:
    """The base of `Slave` and `Replay`: answers on a link while its `with` block runs."""

    def __init__(self, on: str, profiles: Sequence[Profile]) -> None:
        link = slave_link(parse_link(on, ANSWERED))
        self._spec: SerialLink | TcpLink = link
        self._profiles = profiles
        self._records: deque[Record] = deque(maxlen=MAX_KEPT)
        self._switch: FaultSwitch | None = None
        self._shell: Shell
        self._monitor: SlaveMonitor

    def _wrapped(self, slave: Responder) -> Responder:
        self._switch = FaultSwitch(slave, self._spec, self._profiles)
        return self._switch

    # The methods below start and stop the slave, and say on which link it answers.

    def __enter__(self) -> Self:
        self.start()
        return self

    def __exit__(self, kind: object, *_: object) -> None:
        self._shell.stop()
        if kind is None:
            self._shell.wait(0)

    def start(self) -> None:
        """Open the link and begin to answer, as entering the `with` block does.

        Raises LinkError if the link cannot be opened.
        """
        self._shell.start()
        if isinstance(self._shell, TcpSlave | UdpSlave):
            self._spec = replace(self._shell.link, endpoint=self._shell.endpoint)
            self._monitor.on_link(self._spec.name)

    def stop(self) -> None:
        """Stop answering, and close the link; the recorded requests are still there.

        Raises LinkError if the link was lost while the slave answered.
        """
        self._shell.stop()
        self._shell.wait(0)

    @property
    def link(self) -> str:
        """The LINK as text; a TCP port 0 is replaced by the one that the system chose."""
        return self._shell.place

    @property
    def host(self) -> str:
        """The address for a master to connect to. Raises LinkError on a serial line."""
        return self._tcp.endpoint.host

    @property
    def port(self) -> int:
        """The TCP port for a master to connect to. Raises LinkError on a serial line."""
        return self._tcp.endpoint.port

    @property
    def _tcp(self) -> TcpSlave | UdpSlave:
        if not isinstance(self._shell, TcpSlave | UdpSlave):
            raise LinkError(f"{self.link}: a serial line has no TCP host and port")
        return self._shell

    # The methods below are about the requests that masters sent.

    @property
    def records(self) -> list[Record]:
        """All requests with their responses, and an event for each fault, in order.

        These are at most the last 100,000. A response that a fault distorted has the bytes that
        were sent.
        """
        self._records.extend(self._monitor.records())
        return list(self._records)

    @property
    def asked(self) -> list[NamedTransaction]:
        """All requests so far, each with the response that it got."""
        return [one for one in self.records if not isinstance(one, WireEvent)]

    @property
    def unanswered(self) -> list[NamedTransaction]:
        """The requests that got no response: to an absent unit, or because of a fault."""
        return [one for one in self.asked if one.outcome is Outcome.NO_ANSWER]

    def assert_asked(
        self,
        what: str,
        times: int | None = None,
        *,
        unit: int | None = None,
        function: int | None = None,
        written: float | str | Sequence[int] | None = None,
    ) -> list[NamedTransaction]:
        """Assert that masters asked for a register or bit, and return those requests.

        `what` is a reference of the device ("HR400001"), a range ("HR400001..400004"), or without a
        profile "holding 0..3". A request counts if it reads or writes at least one address of
        `what`; with `written`, if it writes these values from the first address of `what` on. Of a
        named point `written` is its value in its unit, as in
        `assert_asked("Setpoint", written=21.5)`; else it has the contents of registers.
        Without `times`, one request is enough; with `times=0` there must be none.

        Raises AssertionError with a list of the requests that came, UsageError for an unknown
        reference.
        """
        __tracebackhide__ = True
        span = self._span(what)
        values = self._contents(what, written)
        asked = self.asked
        found = [
            one
            for one in asked
            if (unit is None or one.unit == unit)
            and (function is None or one.function == function)
            and _touches(one, span)
            and (values is None or _written_at(one, span) == values)
        ]
        if bool(found) if times is None else len(found) == times:
            return found
        raise AssertionError(_failure_text(what, times, written, len(found), asked))

    def _contents(self, what: str, written: float | str | Sequence[int] | None) -> list[int] | None:
        """Return the contents of registers for a value that a request writes to `what`."""
        __tracebackhide__ = True
        if written is None:
            return None
        if not isinstance(written, int | float | str):
            return list(written)
        target = self._target(what)
        if target is not None and (target.point is not None or isinstance(written, int)):
            try:
                return target.registers(written)
            except UsageError as error:
                raise UsageError(f"{what}: written={written!r}: {error}") from None
        if not isinstance(written, int):
            raise UsageError(f"{what}: written={written!r}: no profile has a point there")
        return [written]

    def _target(self, what: str) -> ValueTarget | None:
        """Find the register or point of the first profile that knows `what`; None if none does."""
        for targets in self._value_targets:
            with suppress(UsageError):
                return targets.find(what)
        return None

    @cached_property
    def _value_targets(self) -> list[ValueTargets]:
        return [ValueTargets(profile) for profile in self._profiles]

    def _span(self, what: str) -> Span:
        __tracebackhide__ = True
        try:
            span = find_span(what, self._profiles)
        except UsageError as error:
            raise error.with_traceback(None) from None  # Hide the calls inside mbtool.
        if span is not None:
            return span
        named = self._target(what)
        if named is not None:
            return Span(named.table, named.address, named.address + named.words - 1)
        names = " or ".join(one.name for one in self._profiles)
        of_device = f" of {names}; write it as the manual does, or" if names else "; write"
        raise UsageError(
            f"{what!r} is no register or bit{of_device} 'holding 10..20', or with coil, "
            "discrete or input"
        )

    def forget(self) -> None:
        """Forget all requests so far, so that assertions see only later ones."""
        self._monitor.records()
        self._records.clear()

    def lines(self, last: int | None = None) -> list[str]:
        """Return the requests and events as text, a line each: all of them, or the `last` ones."""
        records = self.records
        return [_line(one) for one in (records if last is None else records[-last:])]

    def save_log(self, path: AnyPath) -> None:
        """Write the recorded requests to a log (.mcap), which `mbtool decode` and `replay` read.

        A file of that name is replaced. Raises UsageError if it cannot be created, OutputError if
        it cannot be written.
        """
        from mbtool.logs.opening import create_log

        log = create_log(fspath(path), [self._spec], self._monitor.assignments, overwrite=True)
        try:
            for record in self.records:
                log.write(record)
        finally:
            log.close({})

    # The methods below add and remove faults, which spoil responses on purpose.

    def fault(self, kind: str, **keys: object) -> None:
        """Spoil responses from now on: `slave.fault("exception", code=6, times=2)`.

        docs/faults.md lists the kinds and their keys: delay, no-answer, exception, wrong-unit,
        close and others; `registers`, `units`, `functions`, `nth`, `every` and `times` say which
        requests. Several faults act one after the other. Raises UsageError for a fault that is
        wrong.
        """
        __tracebackhide__ = True
        try:
            self._add_faults([{"kind": kind, **keys}])
        except UsageError as error:
            raise error.with_traceback(None) from None  # Hide the calls inside mbtool.

    def clear_faults(self) -> None:
        """Remove all faults, so that responses are correct again."""
        if self._switch is not None:
            self._switch.clear()

    def _add_faults(self, faults: AnyPath | Sequence[Mapping[str, object]]) -> None:
        if self._switch is None:
            return
        if isinstance(faults, Sequence) and not isinstance(faults, str):
            source: Mapping[str, Any] | Path = {"faults": [dict(one) for one in faults]}
        else:
            source = Path(fspath(faults))
        self._switch.add(source)


def monitor_of(
    profile: Profile | None, on: LinkSpec, others: Mapping[int, Profile] | None = None
) -> SlaveMonitor:
    return SlaveMonitor(profile, on, others, limit=MAX_KEPT)


def _touches(one: NamedTransaction, span: Span) -> bool:
    return any(part.start <= span.last and span.first < part.stop for part in _parts(one, span))


def _parts(one: NamedTransaction, span: Span) -> list[range]:
    """Return the address ranges that a request reads or writes in the table of `span`.

    There are two for a request that reads and writes (17H), and none for another table.
    """
    function = FUNCTIONS.get(one.function)
    if function is None or function.table is not span.table or one.address is None:
        return []
    parts = [range(one.address, one.address + (1 if one.quantity is None else one.quantity))]
    if one.write_address is not None:
        parts.append(range(one.write_address, one.write_address + one.written_quantity))
    return parts


def _written_at(one: NamedTransaction, span: Span) -> list[int] | None:
    """Return the values that a request writes from the first address of `span` on.

    Values behind the end of `span` are left out, unless `span` is a single address. Returns None if
    the request writes nothing, or begins behind the first address of `span`.
    """
    function = FUNCTIONS.get(one.function)
    first = one.write_address if one.function == READ_WRITE_REGISTERS else one.address
    if (
        function is None
        or first is None
        or not one.request_values
        or not (function.writes or one.function == READ_WRITE_REGISTERS)
    ):
        return None
    begin = span.first - first
    if begin < 0:
        return None
    if span.first == span.last:
        return one.request_values[begin:]
    return one.request_values[begin : begin + span.last - span.first + 1]


def _line(record: Record) -> str:
    if isinstance(record, WireEvent):
        return f"{clock_time(record.ts_ns)}  {event_text(record)}"
    text = transaction_text(record, record.read_points or None)
    return f"{clock_time(record.start_ns)}  unit {record.unit}  {text}"


def _failure_text(
    what: str, times: int | None, values: object, found: int, asked: Sequence[NamedTransaction]
) -> str:
    wanted = "at least once" if times is None else "once" if times == 1 else f"{times} times"
    written = "" if values is None else f" with {values} written"
    count = "never" if not found else "once" if found == 1 else f"{found} times"
    if not asked:
        return f"{what}{written}: asked {count}, not {wanted}; no request came at all"
    shown = "\n".join(f"    {_line(one)}" for one in asked[-_SHOWN:])
    more = "" if len(asked) <= _SHOWN else f" (the last {_SHOWN} of {len(asked)})"
    return f"{what}{written}: asked {count}, not {wanted}. What was asked{more}:\n{shown}"
