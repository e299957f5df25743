"""Runs a virtual line as a process: mbtool.sources.virtual_line_hub ENDS CHARACTER_NS [LINK...]."""

# ENDS is the number of ends, CHARACTER_NS the character time in ns. Each LINK is the path of a
# symbolic link to make: the first one leads to the first end, the second one to the second end.
#
# If a program writes a character to an idle end, the other ends receive it one character time
# later, as on a wire, where a character is received when its stop bit has passed. The next
# character follows one character time after that. The times of all characters of a burst are
# counted from its first one, so if the process wakes up late, only the characters that are due then
# are delayed. No character is early. Two deliveries are at least GRAIN_NS apart: up to 38400 baud
# every character is delivered alone, at 115200 baud three are delivered at once.
#
# If two ends write at once, the others receive the characters of both, interleaved and useless, as
# on a wire. No end receives its own characters.
#
# Limits: the hub reads an end only while fewer than MAX_PENDING characters of it are pending, so a
# writer must wait, as for a port's buffer. If no program reads an end, the system keeps the first
# bytes for it (Linux: 4095) and drops later ones, like a port with an overrun. A program that opens
# the end later reads the kept bytes, unless it flushes its input as pyserial and this package do.
#
# A pseudo-terminal has a side for the hub and a side for the user's program; the hub keeps both
# open. Otherwise the hub's side would report EIO as soon as the program closes its side, and the
# terminal would lose its raw mode.
#
# The process ends when its standard input ends (child.py). It then removes the symbolic links that
# it made, except those that somebody has changed to lead elsewhere.

from __future__ import annotations

import json
import os
import select
import signal
import sys
import tty
from collections.abc import Sequence
from contextlib import suppress
from errno import EEXIST
from time import monotonic_ns

from mbtool.sources.child import run_promptly

MAX_PENDING = 4096
GRAIN_NS = 250_000
"""The shortest time between two deliveries of characters to the ends, in ns."""


class Sender:
    """The characters that one end has written and that are not yet delivered to the others."""

    def __init__(self, character_ns: int) -> None:
        self._character_ns = character_ns
        self._pending = bytearray()
        self._next_ns = 0

    @property
    def room(self) -> int:
        return MAX_PENDING - len(self._pending)

    @property
    def next_ns(self) -> int | None:
        """The time at which the next character is due at the other ends, in ns of the monotonic
        clock.

        None if no character is pending.
        """
        return self._next_ns if self._pending else None

    def put(self, data: bytes, now_ns: int) -> None:
        if not self._pending:
            self._next_ns = max(self._next_ns, now_ns + self._character_ns)
        self._pending += data

    def take(self, now_ns: int) -> bytes:
        """Remove and return the characters that are due at `now_ns` of the monotonic clock."""
        if not self._pending or now_ns < self._next_ns:
            return b""
        count = min((now_ns - self._next_ns) // self._character_ns + 1, len(self._pending))
        self._next_ns += count * self._character_ns
        passed = bytes(self._pending[:count])
        del self._pending[:count]
        return passed


def main() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(0))
    run_promptly()
    ends, character_ns = int(sys.argv[1]), int(sys.argv[2])
    links = sys.argv[3:]
    pairs = [os.openpty() for _ in range(ends)]
    for near, far in pairs:
        tty.setraw(far)
        os.set_blocking(near, False)
    ports = [os.ttyname(far) for _, far in pairs]
    made: list[tuple[str, str]] = []
    try:
        for link, port in zip(links, ports, strict=False):
            try:
                _make_link(link, port)
            except OSError as error:
                _print_answer({"errors": [f"cannot make the link {link}: {error.strerror}"]})
                return
            made.append((link, port))
        _print_answer({"ports": links + ports[len(links) :]})
        run(sys.stdin.fileno(), [near for near, _ in pairs], character_ns)
    finally:
        for link, port in made:
            with suppress(OSError):
                if os.readlink(link) == port:
                    os.unlink(link)


def run(control: int, ends: Sequence[int], character_ns: int) -> None:
    """Move characters between the ends until the descriptor `control` reads end of file.

    `ends` are the descriptors of the hub's sides of the pseudo-terminals, `character_ns` is the
    time of one character on the line.
    """
    senders = {end: Sender(character_ns) for end in ends}
    delivered_ns = 0
    while True:
        due = [sender.next_ns for sender in senders.values() if sender.next_ns is not None]
        wait_s = None
        if due:
            wait_s = max(0, max(min(due), delivered_ns + GRAIN_NS) - monotonic_ns()) / 1e9
        listening = [end for end, sender in senders.items() if sender.room]
        ready, _, _ = select.select([control, *listening], [], [], wait_s)
        now_ns = monotonic_ns()
        if control in ready and not os.read(control, 1):
            return
        for end in ready:
            if end != control:
                with suppress(BlockingIOError):
                    senders[end].put(os.read(end, senders[end].room), now_ns)
        if due and now_ns >= max(min(due), delivered_ns + GRAIN_NS):
            delivered_ns = now_ns
            for end, sender in senders.items():
                if passed := sender.take(now_ns):
                    _deliver(passed, [other for other in ends if other != end])


def _deliver(data: bytes, ends: Sequence[int]) -> None:
    for end in ends:
        with suppress(BlockingIOError):
            os.write(end, data)


def _make_link(link: str, port: str) -> None:
    """Make the symbolic link `link`, which leads to the terminal `port`.

    A link of this name whose target is gone is replaced: a line that was killed leaves such links.
    Raises OSError if another file has this name, such as the link of a running line.
    """
    if os.path.islink(link) and not os.path.exists(link):
        os.unlink(link)
    if os.path.islink(link):
        target = os.readlink(link)
        raise FileExistsError(EEXIST, f"it leads to {target}; end that line, or remove the link")
    os.symlink(port, link)


def _print_answer(answer: dict[str, list[str]]) -> None:
    sys.stdout.write(json.dumps(answer) + "\n")
    sys.stdout.flush()


if __name__ == "__main__":
    main()
