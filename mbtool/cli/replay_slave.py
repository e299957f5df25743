"""mbtool replay --as-slave: answer a live master as the recorded slaves did."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import replace
from typing import TYPE_CHECKING

import typer

from mbtool.cli import exit_codes
from mbtool.cli.keys import Keyboard, keyboard
from mbtool.cli.options import condition
from mbtool.cli.progress import with_progress
from mbtool.cli.record_order import start_ns
from mbtool.cli.serve import serve, while_read
from mbtool.cli.talk import say
from mbtool.core.moments import counted, plural
from mbtool.devices import Profile, write_reference
from mbtool.modbus import FUNCTIONS
from mbtool.replay import AnsweredFrom, Progress, RequestKind
from mbtool.workflows.replay_site import PlayedSite, SitePlayer, SiteRun

if TYPE_CHECKING:
    from collections import Counter

    from mbtool.ports.tcp_listener import AllowedPeers
    from mbtool.slave.shells import OnExchange
    from mbtool.workflows.replay_slave import SlaveOptions, SlaveRun
    from mbtool.workflows.shared.slave_monitor import SlaveMonitor

_MOST_KINDS = 10
"""For each slave, at most this many different requests that were never recorded are listed."""
_NAME_WIDTH = 21
"""Width of the column of slaves in characters: enough for an IPv4 address and a port."""


def play_as_slave(
    file: str, on: Sequence[str], options: SlaveOptions, allowed: AllowedPeers, *, prints: bool
) -> None:
    """Answer a live master as the recorded slaves did, until Ctrl-C.

    `on` are the texts of --on: links, or links assigned to slaves. With `prints`, each request is
    shown with its response.
    """
    site = SiteRun(file, on, options, say, with_progress)
    shown = Exchanges() if prints else None
    played = site.play(
        allowed=allowed, on_exchange=lambda one: None if shown is None else shown.of(one)
    )
    with keyboard() as keys, nullcontext() if shown is None else shown.open():
        show = None if shown is None else while_read(shown.show)

        def look() -> None:
            if show is not None:
                show()
            if keys is not None:
                _steer(keys, played)

        try:
            serve(played.shells, _what_is_played(file, site), look, lambda: _say_places(played))
        finally:
            _say_counts(played)


class Exchanges:
    """Prints the requests that masters send to the played slaves, and the responses they get."""

    def __init__(self) -> None:
        self._monitors: dict[str, SlaveMonitor] = {}
        """The monitors, which collect requests and responses, by the slave's name; printed rows
        show this name as their link."""

    def of(self, player: SitePlayer) -> OnExchange:
        from mbtool.workflows.shared.slave_monitor import SlaveMonitor

        monitor = SlaveMonitor(
            None,
            player.link,
            player.run.profile_of,
            is_recorded=lambda unit, pdu: player.run.is_recorded(unit, pdu, player.link),
        )
        monitor.on_link(player.name)
        self._monitors[player.name] = monitor
        return monitor.take

    @contextmanager
    def open(self) -> Iterator[None]:
        """Open standard output for the rows while the context is open."""
        from mbtool.cli.output import open_output

        with open_output(
            None,
            None,
            None,
            lambda one: self._monitors[one.link].profile_for(one),
            condition(None),
            is_summed=False,
        ) as self._out:
            yield

    def show(self) -> None:
        """Print the requests and responses since the last call, in the order of the requests."""
        records = [record for one in self._monitors.values() for record in one.records()]
        missed = sum(one.missed() for one in self._monitors.values())
        for record in sorted(records, key=start_ns):
            self._out.add(record)
        self._out.wait()
        if missed:
            say(f"mbtool: {missed:,} requests not shown: they come faster than they can be printed")


def _steer(keys: Keyboard, played: PlayedSite) -> None:
    """Apply the keys that the user pressed to all slaves, and show the progress of the replay.

    Raises typer.Exit after the key q.
    """
    for control in keys.controls():
        for _, slave in played.played:
            slave.control(control)
    keys.show(_progress([slave.progress() for _, slave in played.played], played))
    if keys.has_quit:
        raise typer.Exit(exit_codes.INTERRUPTED)


def _progress(each: Sequence[Progress], played: PlayedSite) -> Progress:
    """Return the progress of the slave that is farthest in the recording.

    `each` has the progress of every slave. With several slaves, its text counts the requests to
    all of them.
    """
    farthest = max(each, key=lambda one: (one.lap, one.position_ns))
    if len(each) == 1:
        return farthest
    counts = [slave.counts() for _, slave in played.played]
    asked = sum(one.total() for one in counts)
    recorded = sum(one[AnsweredFrom.RECORDED] for one in counts)
    done = f"{asked:,} asked" + (f", {recorded:,} as recorded" if recorded < asked else "")
    return replace(farthest, done=done)


def _what_is_played(file: str, site: SiteRun) -> str:
    if len(site.players) == 1:
        return f"{file}: {_requests(site.players[0].run)}"
    return f"{file}: {len(site.players)} slaves"


def _requests(run: SlaveRun) -> str:
    count = len(run.recording.answers)
    requests = "1 request" if count == 1 else f"{count:,} different requests"
    units = sorted(run.recording.units)
    if not units:
        return f"{requests}; no intact response to any of them was recorded"
    return f"{requests} to {plural(len(units), 'unit')} {', '.join(map(str, units))}"


def _say_places(played: PlayedSite) -> None:
    """If there are several slaves, print which of them answers on which link."""
    if len(played.played) > 1:
        for player, slave in played.played:
            say(f"{player.name}: {_requests(player.run)} on {slave.shell.place}")


def _say_counts(played: PlayedSite) -> None:
    """Print a table of the requests that each slave got, by the source of their responses.

    A response may be a recorded one, or be made from the register values of the recording, and so
    on (AnsweredFrom). Nothing is printed if no request came.
    """
    counts = [(player.name, slave.counts()) for player, slave in played.played]
    if not any(each.total() for _, each in counts):
        return
    kinds = list(AnsweredFrom)
    titles = "".join(f"{one:>{len(one) + 2}}" for one in kinds)
    say(f"{'slave':{_NAME_WIDTH}}{'asked':>8}{titles}")
    for name, each in counts:
        cells = "".join(f"{each[one]:>{len(one) + 2},}" for one in kinds)
        say(f"{name:{_NAME_WIDTH}}{each.total():>8,}{cells}")
    for player, slave in played.played:
        lacking = slave.unrecorded()
        if lacking:
            whose = f" of {player.name}" if len(played.played) > 1 else ""
            say(f"never recorded{whose}: {_kinds_text(lacking, player.run.profile_of)}")


def _kinds_text(lacking: Counter[RequestKind], profile_of: Mapping[int, Profile]) -> str:
    """Return the requests that came and were never recorded, those that came most often first."""
    texts = []
    for kind, count in lacking.most_common(_MOST_KINDS):
        table = FUNCTIONS[kind.code].table if kind.code in FUNCTIONS else None
        what = ""
        if table is not None and kind.address is not None:
            profile = profile_of.get(kind.unit)
            is_write = FUNCTIONS[kind.code].writes
            where = write_reference(profile, table, kind.address, kind.quantity, writing=is_write)
            what = f" {where}"
        times = counted(count, "time", ",")
        texts.append(f"unit {kind.unit} {kind.code:02X}{what} ({times})")
    more = len(lacking) - len(texts)
    return "; ".join(texts) + (f"; and {counted(more, 'other request', ',')}" if more else "")
