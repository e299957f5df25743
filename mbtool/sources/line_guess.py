"""Finds a serial line's settings by listening, and says how certain they are. Never writes."""

# The settings are tried one after the other, the likely ones first, until nearly all bytes are in
# frames with a correct checksum. Each setting is tried until it is clear that it is right or wrong,
# but at most for LISTEN_S if bytes come. Some masters poll only every 30 s, so bytes come in
# bursts. Then a burst without a correct frame is enough to try the next setting, and a burst of a
# correct request with its response, and nothing else, is enough to use the setting. As long as no
# bytes come, the setting is kept. The results of each setting are kept. If no setting is certain
# after the last one, the first is tried again.
#
# Bytes before the first silence are skipped, since they may have been received with the previous
# setting; but at most SKIPPED bytes, as some lines have no visible silence.
#
# The search takes a second on a busy line with usual settings. With a master that polls every 30 s,
# it takes 30 s for each of at most 24 settings. A line that is silent for SILENCE_S ends the
# search, unless the user wants to wait longer.
#
# A setting with parity is called certain only if the driver is known to mark bytes with wrong
# parity: it must have marked some while another setting, or the other parity, was tried.

from __future__ import annotations

from collections.abc import Callable

from mbtool.core import AutoLink, LinkError, SerialFormat, SerialLink
from mbtool.core.moments import counted
from mbtool.ports.clock import now_ns
from mbtool.ports.serial_opening import open_listening
from mbtool.ports.serial_port import IDLE_S, ListeningPort
from mbtool.serial_line.settings_fit import (
    ENOUGH_BYTES,
    LIKELY_FIT,
    SettingsScore,
    SettingsTrial,
    other_parity,
    settings_to_try,
)

LISTEN_S = 10
"""The longest time in seconds for which a setting is tried without a pause, if bytes come."""
SILENCE_S = 60
"""The search ends if nothing is heard on the line for this long (s), unless the user says how long
to wait."""
WAIT_S = 15 * 60
"""The search ends after this time (s), unless the user says how long to wait."""
SKIPPED = 300
"""The most bytes that are skipped before the first silence, with each setting that is tried."""
_BURST_ENDS_NS = 2_000_000_000
"""A burst of bytes has ended after a silence of this length (ns): a splitter waits 1 s for the rest
of a frame."""
_PAIR_NS = 5_000_000_000
"""A request and its response alone are enough if nothing follows for this time, in ns."""
_LONGER = 1.5
"""A setting is given up if no byte comes for this many times the longest silence between bursts so
far, and for at least LISTEN_S."""
_TOLD_NS = 5_000_000_000
"""The least time (ns) between two messages that say how far the search is."""


def guess_line(
    link: AutoLink,
    *,
    wait_s: float | None = None,
    on_progress: Callable[[str], None] = lambda _: None,
    open_: Callable[[str, SerialFormat], ListeningPort] = open_listening,
    clock: Callable[[], int] = now_ns,
) -> tuple[SerialLink, str]:
    """Return the link with the settings found, and a sentence that says how certain they are.

    If the link has two ports, only the port at the master's side is read. `wait_s` is the longest
    time to search, in s; None for the usual times. `on_progress` gets a line each few seconds.
    `open_` opens a port to listen; `clock` returns the time in ns. Raises LinkError if the port
    cannot be opened, if no bytes come, and if no settings fit the bytes.
    """
    to_hear = settings_to_try()
    port = open_(link.ports[0], to_hear[0])
    try:
        return _guess(link, _Listener(link, port, clock, wait_s, on_progress), to_hear)
    finally:
        port.close()


def _guess(
    link: AutoLink, listener: _Listener, to_hear: list[SerialFormat]
) -> tuple[SerialLink, str]:
    trials: dict[SerialFormat, SettingsTrial] = {}
    is_clear = False
    while not is_clear and not listener.is_over():
        for heard_as in to_hear:
            trial = trials.setdefault(heard_as, listener.trial(heard_as))
            if not listener.listen(heard_as, trial):
                continue
            best = trial.scores()[0]
            if best.is_sure:
                return _settled_link(link, best, _how_sure(heard_as, listener))
            if best.is_pair:
                return _settled_link(link, best, "likely, from so few frames")
            if listener.is_over():
                break
        # If each setting has received enough bytes, more bytes change nothing.
        is_clear = all(one.is_decided for one in trials.values())
    if not listener.heard:
        raise _nothing_heard(link, listener)
    scores = [score for trial in trials.values() if trial.heard for score in trial.scores()]
    best, *others = sorted(scores, key=_rank, reverse=True)
    if best.is_likely:
        second = f"; second is {others[0]}" if others else ""
        return _settled_link(link, best, f"likely{second}")
    raise LinkError(
        f"link {link}: no usual line settings fit what was heard; nearest is {best}. "
        f"Name the settings, for example {link.settled(SerialFormat(), ascii=False)}"
    )


class _Listener:
    """Reads the serial port with one setting after the other."""

    def __init__(
        self,
        link: AutoLink,
        port: ListeningPort,
        clock: Callable[[], int],
        wait_s: float | None,
        on_progress: Callable[[str], None],
    ) -> None:
        self._port = port
        self._clock = clock
        self._only_ascii = link.only_ascii
        self._on_progress = on_progress
        self._begin_ns = self._told_ns = self._last_ns = clock()
        self._end_ns = self._begin_ns + round((WAIT_S if wait_s is None else wait_s) * 1e9)
        self._silent_end_ns = self._end_ns
        if wait_s is None:
            self._silent_end_ns = self._begin_ns + SILENCE_S * 10**9
        self._longest_silence_ns = 0
        """The longest silence (ns) between two bursts of bytes; 0 if there was none yet."""
        self._is_busy = False
        """True if enough bytes for a decision have come without a pause."""
        self._fitting: SettingsScore | None = None
        """The score of the setting that has explained most so far; None if none has any frame."""
        self.heard = 0
        """The number of bytes heard, with all settings tried so far."""
        self.marked = 0
        """The number of bytes that the driver has marked as damaged, with all settings tried so
        far."""

    def is_over(self) -> bool:
        """True if the time to search is over."""
        return self._clock() >= (self._end_ns if self.heard else self._silent_end_ns)

    @property
    def seconds(self) -> float:
        """The time since the begin of the search, in s."""
        return (self._clock() - self._begin_ns) / 1e9

    def trial(self, heard_as: SerialFormat) -> SettingsTrial:
        return SettingsTrial(heard_as, only_ascii=self._only_ascii)

    def listen(self, heard_as: SerialFormat, trial: SettingsTrial, most_s: float = 0) -> bool:
        """Read the port with the setting `heard_as`, and let `trial` judge the bytes.

        With `most_s`, listen for at most `most_s` seconds. Returns False if the setting cannot be
        applied to the port.
        """
        try:
            self._port.tune(heard_as)
        except LinkError:
            return False
        begin_ns, marked = self._clock(), trial.marked
        first_ns: int | None = None
        skipped: int | None = 0
        while not self.is_over() and not (most_s and self._clock() - begin_ns >= most_s * 1e9):
            data = self._port.read(IDLE_S)
            at_ns = self._clock()
            begins = at_ns - self._last_ns >= _BURST_ENDS_NS
            self._note(len(data), at_ns)
            if not data:
                skipped = None
                trial.advance(at_ns)
            elif skipped is not None and skipped < SKIPPED:
                skipped += len(data)
            else:
                first_ns = at_ns if first_ns is None or begins else first_ns
                trial.feed(data, self._port.damaged, at_ns)
            # Do not stop right after data: the frame may continue, as some adapters make pauses
            # inside a frame.
            if (not data or trial.heard >= ENOUGH_BYTES) and trial.is_decided:
                self._is_busy = True
                break
            if self._has_tried(trial, begin_ns, first_ns, at_ns):
                break
            self._report_progress(trial, at_ns)
        self.marked += trial.marked - marked
        self._note_fit(trial)
        return True

    def _note(self, count: int, at_ns: int) -> None:
        if count:
            silence_ns = at_ns - self._last_ns
            if self.heard and silence_ns >= _BURST_ENDS_NS:
                self._longest_silence_ns = max(self._longest_silence_ns, silence_ns)
            self.heard += count
            self._last_ns = at_ns

    def _has_tried(
        self, trial: SettingsTrial, begin_ns: int, first_ns: int | None, at_ns: int
    ) -> bool:
        """True if the next setting is to be tried, or this one to be used.

        The setting has been listened to since `begin_ns`; `first_ns` is the time of the first byte
        of the last burst that was judged, None if there was none.
        """
        if first_ns is None:
            # With some settings, a port receives nothing from a line that is much faster.
            patience_ns = max(LISTEN_S * 10**9, round(_LONGER * self._longest_silence_ns))
            if not self._is_busy and not self._longest_silence_ns:
                patience_ns = SILENCE_S * 10**9
            return self.heard > 0 and at_ns - begin_ns >= patience_ns
        if at_ns - self._last_ns < _BURST_ENDS_NS:
            return at_ns - first_ns >= LISTEN_S * 10**9
        best = trial.scores()[0]
        # One correct frame (such as of a slave whose master is not heard) is not enough: go on
        # listening.
        has_fit = best.frames > 0 and best.fit >= LIKELY_FIT
        return not has_fit or (best.is_pair and at_ns - self._last_ns >= _PAIR_NS)

    def _note_fit(self, trial: SettingsTrial) -> None:
        best = trial.scores()[0]
        if best.frames and (self._fitting is None or best.rank > self._fitting.rank):
            self._fitting = best

    def _report_progress(self, trial: SettingsTrial, at_ns: int) -> None:
        """Tell the user how far the search is, each few seconds."""
        if at_ns - self._told_ns < _TOLD_NS:
            return
        self._told_ns = at_ns
        self._note_fit(trial)
        fits = "nothing fits so far"
        if self._fitting is not None:
            settings = self._fitting.settings
            fits = f"{settings.format} {'ASCII' if settings.ascii else 'RTU'} fits so far"
        heard = f"heard {counted(self.heard, 'byte', ',')} in {self.seconds:.0f} s"
        self._on_progress(f"{heard}, {fits}" if self.heard else heard)


def _how_sure(heard_as: SerialFormat, listener: _Listener) -> str:
    """Return a text for the user that says how certain the settings `heard_as` are.

    A setting with parity is certain only if the driver marks damaged bytes. If it has not marked
    any yet, the port is read once more with the other parity, which should give marked bytes.
    """
    if heard_as.parity == "N" or listener.marked:
        return "sure"
    other = other_parity(heard_as)
    trial = listener.trial(other)
    if listener.listen(other, trial, LISTEN_S) and trial.marked:
        return "sure"
    return "sure; but for the parity, of whose errors this port tells nothing"


def _settled_link(link: AutoLink, best: SettingsScore, how_sure: str) -> tuple[SerialLink, str]:
    found = best.settings
    return link.settled(found.format, ascii=found.ascii), f"{link.name}: {best}, {how_sure}"


def _nothing_heard(link: AutoLink, listener: _Listener) -> LinkError:
    return LinkError(
        f"link {link}: nothing was heard in {listener.seconds:.0f} s; does a master poll, "
        "and are A and B connected? --wait 5min listens longer. Or name the settings, for example "
        f"{link.settled(SerialFormat(), ascii=False)}"
    )


def _rank(score: SettingsScore) -> tuple[float, int]:
    return score.rank
