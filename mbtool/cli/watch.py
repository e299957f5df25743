"""mbtool watch: show live tables of links, or of files that are played, on a full screen."""

from __future__ import annotations

import signal
import sys
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from functools import partial
from math import inf
from pathlib import PurePath
from typing import TYPE_CHECKING, Annotated

import typer

from mbtool.cli import exit_codes
from mbtool.cli.listening import (
    allowed_networks,
    chosen_tcp_ports,
    found_settings,
    sniffer_of,
)
from mbtool.cli.option_groups import with_option_groups
from mbtool.cli.options import (
    AllowOption,
    CaptureOptions,
    GuessedTypesOption,
    WhereOption,
    condition,
    given_types,
)
from mbtool.cli.talk import Interrupt, Interrupted, interruptible, never_waiting, say
from mbtool.core import UsageError, parse_link
from mbtool.core.extras import missing_extra
from mbtool.core.link_spec import HEARD

if TYPE_CHECKING:
    from types import FrameType

    from mbtool.decode.decoder import Record
    from mbtool.workflows.shared.reading import ReadingOptions
    from mbtool.workflows.watch import WatchFeed
    from mbtool.workflows.watch_saving import Saver

_MODES_OFF = "\x1b[?1000l\x1b[?1002l\x1b[?1003l\x1b[?1006l\x1b[?1015l\x1b[?2004l\x1b[?1004l"
"""Escape codes that end the terminal's reports of the mouse, of pasted text and of the focus, which
a full screen switches on."""
_RESTORE = f"{_MODES_OFF}\x1b[<u\x1b[?1049l\x1b[?25h\x1b[0m"
"""Escape codes that end what a full screen switches on: the reports of _MODES_OFF, special codes of
keys and the alternate screen. Then they show the cursor and set the normal style."""


@with_option_groups
def watch(
    sources: Annotated[
        list[str],
        typer.Argument(
            metavar="LINK|FILE",
            help="Links to listen on, as for sniff; or captures and logs, as for decode.",
        ),
    ],
    *,
    write: Annotated[
        str | None,
        typer.Option("--write", "-w", metavar="FILE.mcap", help="Log all that is heard."),
    ] = None,
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="Replace the log if there is one of that name.")
    ] = False,
    capture: CaptureOptions,
    types: GuessedTypesOption = None,
    where: WhereOption = None,
    play: Annotated[
        bool, typer.Option("--play", help="Play a file from its beginning, as it was recorded.")
    ] = False,
    duration: Annotated[
        float | None,
        typer.Option("--duration", metavar="S", min=0, help="Leave after so many seconds."),
    ] = None,
    allow: AllowOption = None,
) -> None:
    """Watch links or files on a full screen.

    It shows polls, points, transactions, events, slaves and the bus load as they come; ? shows the
    keys, and docs/watch.md explains each view. It needs mbtool[watch].
    """
    from mbtool.cli.stats import is_link
    from mbtool.cli.watching.terminal_output import prepare_terminal

    _demand_textual()
    condition(where)
    live = [is_link(one) for one in sources]
    if any(live) and not all(live):
        raise UsageError("name files or links, not both")
    if any(live) and (capture.raw or play or capture.source.link is not None):
        raise UsageError("--raw, --link and --play go with files")
    if not any(live) and (write is not None or overwrite or allow):
        raise UsageError("--write, --overwrite and --allow go with a link")
    if not sys.stdout.isatty():
        raise UsageError("watch needs a terminal; into a pipe or file, use sniff, decode or stats")
    if sys.stdin is None or not sys.stdin.isatty():
        state = "is closed" if sys.stdin is None else "is no terminal"
        raise UsageError(
            f"watch takes its keys from standard input, which {state}: let that be the terminal, "
            "or use sniff, decode or stats"
        )
    prepare_terminal()
    given, guesses = given_types(types)
    with never_waiting():
        if any(live):
            _watch_links(sources, write, capture, given, guesses, where, allow, duration, overwrite)
        else:
            options = capture.read(given)
            _watch_files(sources, options, where, duration, plays=play, guesses=guesses)


def _demand_textual() -> None:
    try:
        import textual  # noqa: F401 - only if it is there
    except ImportError:
        raise missing_extra("watch", "watch") from None


def _watch_links(
    sources: Sequence[str],
    write: str | None,
    capture: CaptureOptions,
    types: list[str],
    guesses: bool,
    where: str | None,
    allow: list[str] | None,
    duration: float | None,
    overwrite: bool,
) -> None:
    from mbtool.cli.log_options import place_of
    from mbtool.logs.opening import check_log_path, create_log
    from mbtool.workflows.shared.checked_log import begin_checked
    from mbtool.workflows.shared.model_hints import ModelHints
    from mbtool.workflows.shared.unreadable_lines import UnreadableLines
    from mbtool.workflows.sniff import serial_lines
    from mbtool.workflows.watch import MAX_REMARKS, LinkFeed, make_watched
    from mbtool.workflows.watch_saving import EvidenceSaver, FrameSaver

    specs = [parse_link(link, HEARD) for link in sources]
    allowed, tcp_ports = allowed_networks(specs, allow), chosen_tcp_ports(specs, capture.source)
    timing = capture.timing(types)
    devices = timing.assignments
    serial_lines(specs)
    if write is not None:
        check_log_path(write, overwrite=overwrite)
    specs = timing.given(found_settings(specs, None))
    lines = serial_lines(specs)
    begin = partial(
        create_log, links=specs, assignments=devices, overwrite=overwrite, **tcp_ports._asdict()
    )
    checked = partial(begin_checked, partial(begin, write or ""), timing, lines, tcp_ports.expected)
    remarks: deque[str] = deque(maxlen=MAX_REMARKS)
    sniffer = sniffer_of(
        specs,
        timing,
        tcp_ports,
        allowed,
        None if write is None else checked,
        on_remark=remarks.append,
        reconnects=True,
    )
    watched = make_watched(
        lambda link: timing.format_of(lines[link]) if link in lines else None, devices.profile_for
    )
    if not guesses:
        watched.show_words()
    hints, unreadable = ModelHints(devices.profile_for), UnreadableLines(lines.get, is_live=True)
    saver = FrameSaver(begin) if write is None else EvidenceSaver([write])
    with interruptible() as interrupt, ExitStack() as opened:
        opened.enter_context(sniffer)
        place = ", ".join(sniffer.places)
        feed = LinkFeed(
            sniffer,
            opened.pop_all(),
            watched,
            ends=_end(interrupt, duration),
            notes=(hints.note, unreadable.note),
            remarks=remarks,
        )
        try:
            _show(feed, place, saver, write, where, _end(interrupt, duration), interrupt)
        finally:
            if write is not None:
                say(f"log: {place_of(write)}")


def _watch_files(
    files: Sequence[str],
    options: ReadingOptions,
    where: str | None,
    duration: float | None,
    *,
    plays: bool,
    guesses: bool,
) -> None:
    from mbtool.workflows.shared.reading import Reading
    from mbtool.workflows.watch import FileFeed, make_watched
    from mbtool.workflows.watch_saving import EvidenceSaver

    reading = Reading(files, options)
    reading.demand_files()
    readings = [reading]

    def records() -> Iterator[Record]:
        readings[0] = Reading(files, options)
        return readings[0].records()

    watched = make_watched(
        lambda link: readings[0].format_of(link), lambda one: readings[0].profile_for(one)
    )
    feed = FileFeed(records, watched, plays=plays)
    if not guesses:
        watched.show_words()
    with interruptible() as interrupt:
        place = ", ".join(PurePath(file).name for file in files)
        saver = EvidenceSaver(files, options)
        _show(feed, place, saver, None, where, _end(interrupt, duration), interrupt)
    for remark in readings[0].remarks:
        say(remark)


def _show(
    feed: WatchFeed,
    place: str,
    saver: Saver,
    recording: str | None,
    where: str | None,
    ends: Callable[[], bool],
    interrupt: Interrupt,
) -> None:
    """Run the full screen until the user leaves it, then end the feed, which reads the records.

    `place` names the links or files, `recording` is the path of the log (None: no log), `where` the
    first filter. `ends` returns True after a signal or when --duration is over. Raises typer.Exit
    with the exit code, or the error that ended the feed.
    """
    from mbtool.cli.watching.app import WatchApp
    from mbtool.cli.watching.terminal_output import accept_any_byte, terminal_output

    if where is not None:
        feed.watched.set_filter(condition(where))
    try:
        with _ended_by_signals(interrupt), restored_terminal(), terminal_output(ends) as is_gone:
            app = WatchApp(
                feed, place, saver=saver, recording=recording, where=where or "",
                # SIGHUP does not come if the command has a session of its own.
                is_asked_to_end=lambda: is_gone() or ends(),
            )  # fmt: skip
            accept_any_byte()
            code = app.run()
            was_gone = is_gone()
    finally:
        feed.stop()
    if app.unsaid is not None:
        say(app.unsaid)
    if feed.error is not None:
        raise feed.error
    if app.return_code:  # textual has printed why the screen failed.
        raise typer.Exit(app.return_code)
    if interrupt.asked or was_gone:
        raise Interrupted
    raise typer.Exit(code or exit_codes.DONE)


def _end(interrupt: Interrupt, duration_s: float | None) -> Callable[[], bool]:
    """Return a function that returns True once a signal has come or `duration_s` seconds are over.

    With `duration_s` None, only a signal counts.
    """
    from mbtool.ports.clock import steady_clock

    clock = steady_clock()
    end_ns = inf if duration_s is None else clock() + duration_s * 1e9
    return lambda: interrupt.asked or clock() >= end_ns


@contextmanager
def _ended_by_signals(interrupt: Interrupt) -> Iterator[None]:
    """While the context is open, a terminal that goes away ends the command, as SIGTERM does.

    Further signals change nothing: an error raised in the screen's main loop would leave textual's
    thread that reads the keyboard, and the command would never end.
    """

    def ask(number: int, frame: FrameType | None) -> None:
        if not interrupt.asked:
            interrupt.ask(number, frame)

    numbers = [signal.SIGINT, signal.SIGTERM]
    if hasattr(signal, "SIGHUP"):
        numbers.append(signal.SIGHUP)
    before = [(number, signal.signal(number, ask)) for number in numbers]
    try:
        yield
    finally:
        for number, handler in before:
            signal.signal(number, handler)


@contextmanager
def restored_terminal() -> Iterator[None]:
    """Restore the terminal when the context ends, even by an unexpected error of the screen."""
    from mbtool.cli.watching.terminal_output import TerminalOutput

    try:
        import termios
    except ImportError:
        yield
        return
    descriptor = sys.stdin.fileno()
    try:
        before = termios.tcgetattr(descriptor)
    except termios.error:
        raise KeyboardInterrupt from None  # The terminal is gone already.
    try:
        yield
    except BaseException:
        TerminalOutput(sys.stdout, lambda: True).write(_RESTORE)
        raise
    finally:
        with suppress(termios.error):  # The terminal may be gone.
            termios.tcsetattr(descriptor, termios.TCSANOW, before)
