"""Writes a log of `sniff` and adds the findings (broken rules) that need several transactions."""

# A transaction contains the codes of findings that concern it alone; the log writer writes them
# with it. For all other findings, each item of the log is passed to the rules of `check`. Findings
# about the whole capture are written when the log is closed.
#
# Memory: that of the rules, which their modules in devices/checking/ state.

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Protocol

from mbtool.core import SerialLink, WireEvent
from mbtool.devices import NamedTransaction
from mbtool.devices.checking.capture_context import CaptureContext
from mbtool.ledger.account import Account
from mbtool.troubles.judge import Judge, Judgement
from mbtool.troubles.words import WORDS
from mbtool.workflows.shared.recorder import Log

if TYPE_CHECKING:
    from mbtool.decode.line_timing import LineTiming
    from mbtool.devices.checking.finding import Finding
    from mbtool.logs.messages import DecodingMark, LogItem


class FindingsLog(Log, Protocol):
    """A log writer to which findings can be written, too."""

    def add_finding(self, finding: Finding, known_ns: int) -> None: ...


def begin_checked(
    begin: Callable[[], FindingsLog],
    timing: LineTiming,
    lines: Mapping[str, SerialLink],
    ports: frozenset[int] | None,
) -> CheckedLog:
    """Create a log with `begin`, and return a writer that adds the findings of the rules to it.

    `timing` gives the silences of each serial line for the rules. `lines` are the serial links by
    name. `ports` are the TCP ports that should carry Modbus; None for all ports.
    """
    formats = {name: timing.format_of(line) for name, line in lines.items()}
    return CheckedLog(begin(), CaptureContext(timing.assignments, formats.get, ports=ports))


class CheckedLog:
    """A log writer that passes all items on to another one, and adds the findings of the rules."""

    def __init__(self, log: FindingsLog, context: CaptureContext) -> None:
        self._log = log
        self._judge = Judge(Account(context.line_of), context)
        self._last_ns = 0

    def write(self, item: LogItem | DecodingMark) -> None:
        """Write an item, and then the findings that the rules report when they get this item.

        Raises OutputError if the log cannot be written.
        """
        self._log.write(item)
        if isinstance(item, NamedTransaction):
            known_ns = item.start_ns if item.response_ns is None else item.response_ns
            written = item.findings
        elif isinstance(item, WireEvent):
            known_ns, written = item.ts_ns, []
        else:
            return
        self._last_ns = max(self._last_ns, known_ns)
        self._judge.count(item)
        self._add((one for one in self._judge.check(item) if one.code not in written), known_ns)

    def tick(self, now_ns: int) -> None:
        self._log.tick(now_ns)

    def close(self, final: Mapping[str, str]) -> None:
        try:
            self._add(self._judge.end_capture(), self._last_ns)
            self._judge.ledger.settle()
            # Broken rules are in the log already.
            troubles = [one for one in self.judgement().troubles if one.code in WORDS]
            at_ns = self._last_ns
            findings = [one.finding for one in troubles]
            self._add((replace(one, ts_ns=one.ts_ns or at_ns) for one in findings), at_ns)
        finally:
            self._log.close(final)

    def judgement(self) -> Judgement:
        """Judge what was written so far."""
        return self._judge.judgement()

    def _add(self, findings: Iterable[Finding], known_ns: int) -> None:
        for finding in findings:
            self._judge.note(finding)
            self._log.add_finding(finding, known_ns)
