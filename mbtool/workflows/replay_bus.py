"""Replays a recording on a serial line: sends the bytes of the master and of the slaves."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass

from mbtool.core import LinkSpec, SerialLink, UsageError
from mbtool.core.moments import SECOND_NS
from mbtool.ports.serial_opening import open_port, port_in_use
from mbtool.replay import BusPlayer, PlayClock, PlayerControls, Steering
from mbtool.workflows.shared.bus_recording import read_pieces
from mbtool.workflows.shared.read_all import Watch, unwatched
from mbtool.workflows.shared.recorded import PlayOptions, lateness_p99_ns

_LOOP_GAP_NS = SECOND_NS
"""With --loop, this much recorded time (ns) passes between the end of the recording and its next
beginning."""
_LOOK_NS = 30_000_000
"""The longest interval (ns) between two checks of the user's keys and of the caller's function
`stops`."""


@dataclass(frozen=True, slots=True, kw_only=True)
class BusOptions(PlayOptions):
    """The options for replaying a recording as the master and the slaves of a serial line
    together.
    """

    is_loop: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class BusReport:
    """The result of a replay: the number of pieces sent (bytes given to the port at once), and
    their delays.
    """

    pieces: int
    bytes: int
    held: int
    """The number of pieces that were sent late because the port was still sending earlier ones."""
    lateness_p99_ns: int | None
    """The 99th percentile, in ns, of the delays between a piece's recorded time and its sending.
    Pieces counted in `held` are left out. None if no others were sent, or if the recording was
    played as fast as possible."""


def line_link(link: LinkSpec) -> SerialLink:
    """Return `link` if it is a serial line with one port. Raises UsageError for any other link."""
    if not isinstance(link, SerialLink):
        raise UsageError(
            f"link {link}: a bus is a serial line: rtu:PORT@19200-8E1 or ascii:PORT@9600-7E1"
        )
    link.demand_one_port()
    return link


class BusRun:
    """Reads a recording, then sends its bytes, those of the master and of the slaves, on a serial
    line.
    """

    def __init__(
        self,
        path: str,
        options: BusOptions,
        link: SerialLink,
        on_remark: Callable[[str], None] = lambda _: None,
        watch: Watch = unwatched,
    ) -> None:
        """Read the recording and make the bytes to send. PDUs that were recorded on a network get
        serial frames.

        `on_remark` gets lines for the user about the file. Raises InputError if the file cannot be
        read or has nothing to play. Raises UsageError if it has several lines, or a line of another
        mode (RTU or ASCII) than `link`.
        """
        self._options = options
        self._link = link
        self.pieces = read_pieces(path, options, link, on_remark, watch)

    @property
    def length_ns(self) -> int:
        """The length of the part to be played, in ns of recorded time: up to --end, or else up to
        the last bytes.
        """
        window = self._options.window
        if window.end_ns is not None:
            return window.end_ns - window.start_ns
        return self.pieces[-1].position_ns

    def play(
        self,
        *,
        stops: Callable[[], bool] = lambda: False,
        on_open: Callable[[], None] = lambda: None,
        controls: PlayerControls | None = None,
    ) -> BusReport:
        """Send all bytes; end early when `stops` returns True. `on_open` is called when the port is
        open.

        `controls` gives the user's keys (pause, step, faster, slower) and shows the progress; None
        for none. Raises LinkError if the port cannot be opened or is lost.
        """
        link, options = self._link, self._options
        clock = PlayClock(
            self.length_ns, rate=options.rate, gap_ns=_LOOP_GAP_NS, is_loop=options.is_loop
        )
        player = BusPlayer(
            self.pieces,
            clock,
            character_ns=link.format.character_ns,
            silence_ns=link.format.t3_5_ns,
        )
        steering = Steering(clock, player.allow_step)
        with closing(open_port(link, timeout_s=0)) as port, port_in_use(link):
            on_open()
            steering.begin(time.monotonic_ns())
            while not player.has_ended and not stops():
                now_ns = time.monotonic_ns()
                if controls is not None:
                    steering.update(controls, now_ns, f"{player.bytes:,} bytes")
                piece = player.next_run(now_ns)
                if piece is not None:
                    port.write(piece.data)
                    continue
                wake_ns = player.wake_ns(now_ns)
                rest_ns = _LOOK_NS if wake_ns is None else min(wake_ns - now_ns, _LOOK_NS)
                time.sleep(max(rest_ns, 0) / SECOND_NS)
            _wait_until_sent(player)
        return _report(player, options)


def _wait_until_sent(player: BusPlayer) -> None:
    """Wait until the port has sent its last byte, as closing it earlier could discard bytes."""
    if player.passed_ns is not None:
        time.sleep(max(player.passed_ns - time.monotonic_ns(), 0) / SECOND_NS)


def _report(player: BusPlayer, options: BusOptions) -> BusReport:
    return BusReport(
        pieces=player.sent,
        bytes=player.bytes,
        held=player.delayed if options.rate else 0,
        lateness_p99_ns=lateness_p99_ns(player.lateness, options),
    )
