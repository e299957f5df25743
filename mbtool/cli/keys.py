"""The keys that control a replay, and the line that shows its progress."""

# Keys are read only if standard input is a terminal and this program is in its foreground: the
# system would stop a background program that changes the settings of a terminal. While keys are
# read, the terminal delivers each key at once and does not echo it; Ctrl-C remains a signal. At the
# end the terminal gets its former settings back. The progress line is redrawn on standard error if
# this is a terminal, too.
#
# Keys work on Linux and macOS only. Elsewhere there are no keys, but everything else works.

from __future__ import annotations

import os
import select
import shutil
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from typing import TextIO

from mbtool.cli.talk import interruptible, redrawn_line
from mbtool.replay.steering import Control, Progress

KEYS = ("space pauses, s steps, + and - change the speed, q ends", "keys: space s + - q")
"""Two texts that name the keys and their effect. The progress line uses the second, shorter one if
the first does not fit behind it, as on 80 columns."""

_LOOK_S = 0.03
"""Time in s between two checks for keys: too short for a person to notice."""
_DRAW_S = 0.1
_READ_BYTES = 64
_QUIT = "q"
_CONTROLS = {
    " ": Control.PAUSE,
    "s": Control.STEP,
    "\x1b[C": Control.STEP,  # The arrows right, up and down; terminals have two codes.
    "\x1bOC": Control.STEP,
    "+": Control.FASTER,
    "=": Control.FASTER,  # On many keyboards, + is = with shift.
    "\x1b[A": Control.FASTER,
    "\x1bOA": Control.FASTER,
    "-": Control.SLOWER,
    "\x1b[B": Control.SLOWER,
    "\x1bOB": Control.SLOWER,
}
_ERASE = "\r\x1b[K"


class Keyboard:
    """The keys of a terminal, and the line on it that shows the progress of a replay."""

    def __init__(self, descriptor: int, out: TextIO) -> None:
        self._descriptor = descriptor
        self._out = out
        self._draws = out.isatty()
        self._looked_s = self._drawn_s = -1.0
        self._is_drawn = False
        self._is_open = True
        self.has_quit = False

    def controls(self) -> Sequence[Control]:
        """Return the commands of the keys that were pressed since the last call.

        The terminal is read at most every 30 ms; a call before that returns nothing. The key q
        gives no command, but sets `has_quit`.
        """
        now_s = time.monotonic()
        if not self._is_open or now_s - self._looked_s < _LOOK_S:
            return ()
        self._looked_s = now_s
        pressed = b""
        with suppress(OSError):
            while select.select([self._descriptor], [], [], 0)[0]:
                data = os.read(self._descriptor, _READ_BYTES)
                if not data:
                    self._is_open = False
                    break
                pressed += data
        keys = list(_keys(pressed.decode("ascii", "replace")))
        self.has_quit = self.has_quit or _QUIT in keys
        return [_CONTROLS[key] for key in keys if key in _CONTROLS]

    def show(self, progress: Progress) -> None:
        now_s = time.monotonic()
        if not self._draws or now_s - self._drawn_s < _DRAW_S:
            return
        self._drawn_s = now_s
        width = shutil.get_terminal_size().columns - 1
        self._write(f"{_ERASE}{progress_line(progress, width)}")
        self._is_drawn = True

    def wipe(self) -> None:
        """Erase the line that shows the progress."""
        if self._is_drawn:
            self._write(_ERASE)
            self._is_drawn = False

    def _write(self, text: str) -> None:
        with suppress(OSError):
            self._out.write(text)
            self._out.flush()


@contextmanager
def keyboard() -> Iterator[Keyboard | None]:
    """Read keys from the terminal while the context is open; yield None if there is no terminal."""
    try:
        import termios
        import tty
    except ImportError:
        yield None
        return
    descriptor = _terminal()
    if descriptor is None:
        yield None
        return
    before = termios.tcgetattr(descriptor)
    keys = Keyboard(descriptor, sys.stderr)
    try:
        tty.setcbreak(descriptor)
        with redrawn_line(keys.wipe):
            yield keys
    finally:
        keys.wipe()
        with suppress(termios.error):  # The terminal may be gone.
            termios.tcsetattr(descriptor, termios.TCSADRAIN, before)


@contextmanager
def controlled() -> Iterator[tuple[Keyboard | None, Callable[[], bool]]]:
    """Yield the keyboard, or None without a terminal, and a function.

    The function returns True once the user has pressed Ctrl-C or q.
    """
    with interruptible() as interrupt, keyboard() as keys:
        yield keys, lambda: interrupt.asked or (keys is not None and keys.has_quit)


def _terminal() -> int | None:
    """Return the file descriptor of standard input, if it is a terminal and mbtool its foreground.

    Otherwise keys cannot be read, and the result is None.
    """
    try:
        descriptor = sys.stdin.fileno()
        is_ours = os.isatty(descriptor) and os.tcgetpgrp(descriptor) == os.getpgrp()
    except (AttributeError, OSError, ValueError):  # Standard input is closed, or was replaced.
        return None
    return descriptor if is_ours else None


def _keys(text: str) -> Iterator[str]:
    """Split the text that a terminal sent into keys: one character each, three for an arrow."""
    place = 0
    while place < len(text):
        size = 3 if text[place : place + 3] in _CONTROLS else 1
        yield text[place : place + size]
        place += size


def progress_line(progress: Progress, width: int) -> str:
    """Return the line that shows the progress of a replay, at most `width` characters.

    It names the keys if there is room.
    """
    text = _progress_text(progress)
    keys = next((keys for keys in KEYS if len(text) + 3 + len(keys) <= width), "")
    return f"{text}   {keys}".rstrip()[:width]


def _progress_text(progress: Progress) -> str:
    if progress.rate is None:
        state = "paused" if progress.is_paused else "playing"
        return f"{state}, as fast as can be; {progress.done}"
    state = "paused " if progress.is_paused else "waiting" if progress.is_waiting else "playing"
    place = f"{clock_text(progress.position_ns)} of {clock_text(progress.length_ns)}"
    lap = f", round {progress.lap + 1}" if progress.lap else ""
    speed = f"x{float(progress.rate):.3g}"
    return f"{state}  {place}{lap}  {speed}  {progress.done}"


def clock_text(time_ns: int) -> str:
    """Write a time in a recording: `3:07.4`, `1:03:07.4`."""
    minutes, tenths = divmod(time_ns // 100_000_000, 600)
    hours, minutes = divmod(minutes, 60)
    seconds = f"{tenths // 10:02}.{tenths % 10}"
    return f"{hours}:{minutes:02}:{seconds}" if hours else f"{minutes}:{seconds}"
