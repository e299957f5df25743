"""Finds a line's settings by listening to it, and says how sure they are. Never writes."""

# One setting after the other, the likelier first, until one explains nearly everything. At each the
# port is listened to until it is sure, or what was heard fits no setting, or for LISTEN_S. What
# comes before the first silence is passed over, since it began before the port listened like this;
# but SKIPPED bytes at most, as a line may have no silence that shows.
#
# It takes a second on a busy line whose settings are usual, and LISTEN_S for each of 24 settings,
# four minutes in all, where hardly anything is heard.
#
# A setting with parity is sure when the driver is known to mark errors: it marked some at another
# setting, if only at the other parity.

from __future__ import annotations

from typing import TYPE_CHECKING

from mbtool.core import AutoLink, LinkError, SerialFormat, SerialLink
from mbtool.ports.clock import now_ns
from mbtool.ports.serial_port import IDLE_S, ListeningPort, open_listening
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
SKIPPED = 300


def guess_line(
    link: AutoLink,
    *,
    open_: Callable[[str, SerialFormat], ListeningPort] = open_listening,
    clock: Callable[[], int] = now_ns,
) -> tuple[SerialLink, str]:
    """The line with its settings, and a sentence that says how sure they are.

    With two taps the master's side is listened to. Raises LinkError when nothing is heard, and when
    nothing fits.
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
    """Hears the line at one setting after the other."""

    def __init__(self, port: ListeningPort, clock: Callable[[], int], *, only_ascii: bool) -> None:
        self._port = port
        self._clock = clock
        self._only_ascii = only_ascii
        self.marked = 0
        """How many bytes the driver called damaged, in all."""

    def listen(self, heard_as: SerialFormat) -> SettingsTrial | None:
        """What is heard; None at a setting that the driver does not do."""
        try:
            self._port.tune(heard_as)
        except LinkError:
            return None
        hearing = SettingsTrial(heard_as, only_ascii=self._only_ascii)
        end_ns = self._clock() + LISTEN_S * 10**9
        passed_over: int | None = 0
        while self._clock() < end_ns:
            data = self._port.read(IDLE_S)
            at_ns = self._clock()
            if not data:
                passed_over = None
                hearing.advance(at_ns)
            elif passed_over is not None and passed_over < SKIPPED:
                passed_over += len(data)
            else:
                hearing.feed(data, self._port.damaged, at_ns)
            # Between the pieces of a frame that an adapter tore it is too early to judge.
            if (not data or hearing.heard >= ENOUGH) and hearing.is_decided:
                break
        self.marked += hearing.marked
        return hearing


def _how_sure(heard_as: SerialFormat, listener: _Listener) -> str:
    """Whether the parity is sure as well: whether the driver would have told that it is wrong."""
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
