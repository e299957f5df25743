"""mbtool poll: read from a slave again and again, and show what changes."""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated

import typer

from mbtool.cli import exit_codes
from mbtool.cli.ask_options import AskOptions, LinkArgument, ReferencesArgument
from mbtool.cli.option_groups import with_option_groups
from mbtool.cli.options import Format, TableOptionGroup
from mbtool.cli.talk import Interrupt, interruptible, say
from mbtool.core import WireEvent
from mbtool.core.moments import parse_duration

if TYPE_CHECKING:
    from mbtool.cli.output import RecordOutput
    from mbtool.devices import NamedTransaction, PointValue, Profile
    from mbtool.views.polled_values import PolledValues
    from mbtool.workflows.ask import Asker, Changes, PollTally

_LEAST_NS = 1_000_000
_MOST_NS = 365 * 86_400 * 10**9
_LISTEN_NS = 1_000_000_000
"""The time (ns) for which another master that left no pause is heard before the next attempt."""


@with_option_groups
def poll(
    link: LinkArgument,
    references: ReferencesArgument,
    *,
    every: Annotated[
        str, typer.Option("--every", metavar="TIME", help="How often to read: 1s, 250ms, 1m30s.")
    ] = "1s",
    count: Annotated[
        int | None,
        typer.Option("--count", metavar="N", min=1, help="Stop after so many rounds."),
    ] = None,
    all_: Annotated[
        bool, typer.Option("--all", help="Show each answer, and not only those that differ.")
    ] = False,
    ask: AskOptions,
    format_: Annotated[Format, typer.Option("--format", help="How to print.")] = Format.TABLE,
    table: TableOptionGroup,
) -> None:
    """Read from a slave again and again, as its master, until Ctrl-C.

    The first answers are shown whole; from then on a row says which values have changed. At the end
    there is a summary. --format csv prints a table for a spreadsheet: a row for each round, with
    its time and all values. With --count, exit 1 when a request gets an exception or no answer.
    """
    from mbtool.views.polled_values import PolledValues
    from mbtool.workflows.ask import Changes, PollTally

    period_ns = parse_duration(every, "--every", _LEAST_NS, _MOST_NS)
    asked, options = ask.read(link, references), table.read()
    requests = [pdu for each in asked.references for pdu in asked.wording.reads(each)]
    tally = PollTally()
    changes = None if all_ else Changes(asked.profile)
    values = PolledValues(requests) if format_ is Format.CSV else None
    shown = Format.TABLE if values is not None else format_
    with (
        interruptible() as interrupt,
        asked.open(shown, options, is_summed=False) as (asker, out),
    ):
        say(f"asking unit {asked.unit} at {asked.link} every {every}; Ctrl-C ends")
        polling = Polling(asker, out, requests, changes, tally, is_table=format_ is Format.TABLE)
        polling.values, polling.profile = values, asked.profile
        polling.run(interrupt, period_ns, count)
    say(tally.sentence())
    if interrupt.asked:
        raise typer.Exit(exit_codes.INTERRUPTED)
    if tally.failed:
        raise typer.Exit(exit_codes.NO)


class Polling:
    """Sends the same requests once in each period, and prints their transactions."""

    def __init__(
        self,
        asker: Asker,
        out: RecordOutput,
        requests: Sequence[bytes],
        changes: Changes | None,
        tally: PollTally,
        *,
        is_table: bool,
    ) -> None:
        """`requests` are PDUs; their transactions are printed on `out` and counted in `tally`.

        `changes` finds the values that differ from those of the last response to the same request;
        with None, every response is printed. `is_table` is True if `out` prints a table, which
        then shows only the changed values.
        """
        self._asker = asker
        self._out = out
        self._requests = requests
        self._changes = changes
        self._tally = tally
        self._is_table = is_table
        self.values: PolledValues | None = None
        """Makes a table of values; None to print transactions."""
        self.profile: Profile | None = None
        self._round: dict[bytes, list[PointValue]] = {}
        self._round_ns = 0
        self._waits = False
        """True once the user was told that a request waits for a pause of another master."""

    def run(self, interrupt: Interrupt, period_ns: int, count: int | None) -> None:
        """Send all requests once in each round, until Ctrl-C or for `count` rounds.

        With `count` None there is no limit. A round begins `period_ns` after the begin of the one
        before. If a round takes longer, the next one begins at its end, and later rounds are due
        from there.
        """
        due_ns = time.monotonic_ns()
        rounds = 0
        self._asker.stop_when(lambda: interrupt.asked)
        while not interrupt.asked and rounds != count:
            for pdu in self._requests:
                self._send(pdu, interrupt)
            self._out.wait()
            if self.values is not None and self._round_ns:
                _write(self.values.lines(self._round_ns, self._round))
                self._round, self._round_ns = {}, 0
            rounds += 1
            now_ns = time.monotonic_ns()
            due_ns = max(due_ns + period_ns, now_ns)
            if rounds != count:
                interrupt.wait((due_ns - now_ns) / 1e9)
        if self.values is not None:
            _write(self.values.take_held_lines())

    def _send(self, pdu: bytes, interrupt: Interrupt) -> None:
        while not interrupt.asked:
            if self._ask(pdu, interrupt):
                return

    def _ask(self, pdu: bytes, interrupt: Interrupt) -> bool:
        """Send a request, and print its transaction; False if another master leaves no pause for
        it, though it left one before.
        """
        from mbtool.master.other_master import NoPauseError

        try:
            transaction, events = self._asker.ask(pdu)
        except NoPauseError as error:
            if interrupt.asked:
                return False
            if not self._tally.outcomes:
                raise
            if not self._waits:
                say(f"mbtool: {error}. poll waits for a longer pause")
                self._waits = True
            self._asker.listen(_LISTEN_NS)
            return False
        self._tally.add(transaction)
        self._print(pdu, transaction, events)
        return True

    def _print(
        self, pdu: bytes, transaction: NamedTransaction, events: Sequence[WireEvent]
    ) -> None:
        from mbtool.workflows.ask import points_of

        if self.values is not None:
            self._round_ns = self._round_ns or transaction.start_ns
            if transaction.response_values is not None:
                self._round[pdu] = points_of(transaction, self.profile)
            return
        for event in events:
            self._out.add(event)
        if self._changes is None:
            self._out.add(transaction)
            return
        changed = self._changes.since_last(pdu, transaction)
        if changed is None:
            self._out.skip()
        else:
            self._out.add(changed if self._is_table else transaction)


def _write(text: str) -> None:
    """Write lines to standard output at once."""
    if text:
        typer.echo(text, nl=False)
        sys.stdout.flush()
