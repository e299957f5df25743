"""Finds a serial line's settings by listening, and says how certain they are. Never writes."""

# The settings are tried one after the other, likely ones first, until nearly all bytes are in
# frames with a correct checksum. With each setting the port is read until it is clear that the
# setting is right or wrong, but at most for LISTEN_S. Bytes before the first silence are skipped,
# since they may have been received with the previous setting; but at most SKIPPED bytes, as some
# lines have no visible silence.
#
# This takes a second on a busy line with usual settings. If hardly any bytes come, it takes
# LISTEN_S for each of 24 settings: four minutes.
#
# A setting with parity is called certain only if the driver is known to mark bytes with wrong
# parity: it must have marked some while another setting, or the other parity, was tried.

from __future__ import annotations

from typing import TYPE_CHECKING

from mbtool.core import AutoLink, LinkError, SerialFormat, SerialLink
from mbtool.ports.clock import now_ns
from mbtool.ports.serial_opening import open_listening
from mbtool.ports.serial_port import IDLE_S, ListeningPort
from mbtool.serial_line.settings_fit import (
    ENOUGH,
    SettingsScore,
    SettingsTrial,
    other_parity,
    settings_to_try,
)

if TYPE_CHECKING:
    from collections.abc import Callable

LISTEN_S = 10
"""The longest time for which a setting is tried, in seconds."""
SKIPPED = 300
"""The most bytes that are skipped before the first silence, with each setting that is tried."""


def guess_line(
    link: AutoLink,
    *,
    open_: Callable[[str, SerialFormat], ListeningPort] = open_listening,
    clock: Callable[[], int] = now_ns,
) -> tuple[SerialLink, str]:
    """Return the link with the settings found, and a sentence that says how certain they are.

    If the link has two ports, only the port at the master's side is read. `open_` opens a port to
    listen; `clock` returns the time in ns. Raises LinkError if the port cannot be opened, if no
    bytes come, and if no settings fit the bytes.
    """
    to_hear = settings_to_try()
    port = open_(link.ports[0], to_hear[0])
    try:
        return _guess(link, _Listener(port, clock, only_ascii=link.only_ascii), to_hear)
    finally:
        port.close()


def _guess(
    link: AutoLink, listener: _Listener, to_hear: list[SerialFormat]
) -> tuple[SerialLink, str]:
    scores: list[SettingsScore] = []
    for heard_as in to_hear:
        hearing = listener.listen(heard_as)
        if hearing is None:
            continue
        if not hearing.heard and not scores:
            break
        scores += hearing.scores()
        best = max(scores, key=_rank)
        if best.is_sure:
            return _found(link, best, _how_sure(heard_as, listener))
    if not scores:
        raise _nothing_heard(link)
    best, *others = sorted(scores, key=_rank, reverse=True)
    if best.is_likely:
        second = f"; second is {others[0]}" if others else ""
        return _found(link, best, f"likely{second}")
    raise LinkError(
        f"link {link}: no usual line settings fit what was heard; nearest is {best}. "
        f"Name the settings, for example {link.settled(SerialFormat(), ascii=False)}"
    )


class _Listener:
    """Reads the serial port with one setting after the other."""

    def __init__(self, port: ListeningPort, clock: Callable[[], int], *, only_ascii: bool) -> None:
        self._port = port
        self._clock = clock
        self._only_ascii = only_ascii
        self.marked = 0
        """The number of bytes that the driver has marked as damaged, with all settings tried so
        far."""

    def listen(self, heard_as: SerialFormat) -> SettingsTrial | None:
        """Read the port with the setting `heard_as`; return how well the bytes fit it.

        Returns None if the setting cannot be applied to the port.
        """
        try:
            self._port.tune(heard_as)
        except LinkError:
            return None
        hearing = SettingsTrial(heard_as, only_ascii=self._only_ascii)
        end_ns = self._clock() + LISTEN_S * 10**9
        skipped: int | None = 0
        while self._clock() < end_ns:
            data = self._port.read(IDLE_S)
            at_ns = self._clock()
            if not data:
                skipped = None
                hearing.advance(at_ns)
            elif skipped is not None and skipped < SKIPPED:
                skipped += len(data)
            else:
                hearing.feed(data, self._port.damaged, at_ns)
            # Do not stop right after data: the frame may continue, as some adapters make pauses
            # inside a frame.
            if (not data or hearing.heard >= ENOUGH) and hearing.is_decided:
                break
        self.marked += hearing.marked
        return hearing


def _how_sure(heard_as: SerialFormat, listener: _Listener) -> str:
    """Return a text for the user that says how certain the settings `heard_as` are.

    A setting with parity is certain only if the driver marks damaged bytes. If it has not marked
    any yet, the port is read once more with the other parity, which should give marked bytes.
    """
    if heard_as.parity == "N" or listener.marked:
        return "sure"
    hearing = listener.listen(other_parity(heard_as))
    if hearing is not None and hearing.marked:
        return "sure"
    return "sure; but for the parity, of whose errors this port tells nothing"


def _found(link: AutoLink, best: SettingsScore, how_sure: str) -> tuple[SerialLink, str]:
    found = best.settings
    return link.settled(found.format, ascii=found.ascii), f"{link.name}: {best}, {how_sure}"


def _nothing_heard(link: AutoLink) -> LinkError:
    return LinkError(
        f"link {link}: nothing was heard in {LISTEN_S} s; does a master poll, and are A and B "
        f"connected? Or name the settings, for example {link.settled(SerialFormat(), ascii=False)}"
    )


def _rank(score: SettingsScore) -> tuple[float, int]:
    return score.rank
