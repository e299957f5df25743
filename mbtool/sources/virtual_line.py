"""A serial line without hardware: connected pseudo-terminals, as the devices of one bus are."""

# Characters written to one end arrive at every other end, at the speed of the line's baud rate and
# character format. The line runs in a process of its own (virtual_line_hub.py): in a thread of a
# process with a busy decoder, characters would arrive in bursts.
#
# The ends are named like any terminal (/dev/pts/7). Symbolic links can give them other names. An
# existing symbolic link of such a name is replaced if its target is gone; any other file of that
# name, also the link of a running line, is an error.

from __future__ import annotations

import json
import os
import select
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Self

from mbtool.core import LinkError, SerialFormat, UsageError
from mbtool.sources.child import end_child, start_child

MAX_ENDS = 16
_START_S = 20.0


@dataclass(slots=True, kw_only=True)
class VirtualLine:
    """A serial line without hardware that exists while its context is open.

    The constructor raises UsageError for a wrong number of ends or symbolic links. Entering the
    context raises LinkError if the line cannot be made.
    """

    ends: int = 2
    format: SerialFormat = field(default_factory=SerialFormat)
    link_names: Sequence[str] = ()
    """Paths of symbolic links to make: the first leads to the first end, and so on."""
    _ports: list[str] = field(default_factory=list, init=False)
    _child: subprocess.Popen[bytes] | None = field(default=None, init=False)

    def __post_init__(self) -> None:
        if not 2 <= self.ends <= MAX_ENDS:
            raise UsageError(f"a virtual line has 2 to {MAX_ENDS} ends, not {self.ends}")
        if len(self.link_names) > self.ends:
            raise UsageError(
                f"a virtual line of {self.ends} ends cannot have {len(self.link_names)} links"
            )
        places = set()
        for name in self.link_names:
            parent, last = os.path.split(os.path.abspath(name))
            place = os.path.join(os.path.realpath(parent), last)
            if place in places:
                raise UsageError(f"{name}: named twice; each end of a line has a name of its own")
            places.add(place)

    @property
    def ports(self) -> list[str]:
        """The path of each end: its symbolic link if it has one, else its terminal."""
        return list(self._ports)

    def __enter__(self) -> Self:
        if sys.platform == "win32":
            raise LinkError("a virtual line needs Linux or macOS; on Windows use com0com")
        self._child = start_child(
            "mbtool.sources.virtual_line_hub",
            str(self.ends),
            str(self.format.character_ns),
            *self.link_names,
        )
        try:
            self._ports = _await_ports(self._child)
        except LinkError:
            self.close()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Remove the line, and the symbolic links that it has made."""
        if self._child is not None:
            end_child(self._child)


def _await_ports(child: subprocess.Popen[bytes]) -> list[str]:
    assert child.stdout is not None
    ready, _, _ = select.select([child.stdout], [], [], _START_S)
    answer = child.stdout.readline() if ready else b""
    if not answer:
        raise LinkError("the process of the virtual line does not start")
    said: dict[str, list[str]] = json.loads(answer)
    for error in said.get("errors", ()):
        raise LinkError(f"virtual line: {error}")
    return said["ports"]
