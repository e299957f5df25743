"""Programs whose power is cut, and what is promised of the files of each."""

from __future__ import annotations

import os
import re
import signal
import socket
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from threading import Event
from typing import TYPE_CHECKING

from mbtool.core import EventKind, MbtoolError, WireEvent
from mbtool.logs import read_log
from tests.kills.senders import TapSender
from tests.power_cuts.disk import Disk, File, records_of
from tests.soak.plant import free_port
from tests.soak.programs import PATIENCE_S, Running

if TYPE_CHECKING:
    from collections.abc import Iterator


CAPTURES = Path(__file__).parents[2] / "captures"
Environment = dict[str, str]


@dataclass
class Cut:
    """What is left after a power cut, and what had happened before it."""

    disk: Disk
    final: Disk
    """The disk at the end of the run; its files have the same numbers."""
    places: Mapping[File, Path]
    image: Path
    ns: int
    """The time, of the journal's clock."""
    told: list[bytes]
    """What the program had sent to sockets or written to standard output."""
    is_over: bool
    """True if the program had ended before the cut."""


class Program:
    """A program that writes files, and what it promises of them."""

    name: str

    def prepare(self, folder: Path) -> None:
        """Make the files that are there before."""

    def run(self, folder: Path, environment: Environment) -> None:
        """Run to the end; `environment` loads the journal, which notes the files in `folder`."""
        raise NotImplementedError

    def wrong(self, cut: Cut) -> Iterator[str]:
        """Say what is missing or wrong after a cut."""
        raise NotImplementedError


class Recording(Program):
    """A log of a tap: what a sync that has ended covers is in it, and nothing else than was heard.

    A rotated log with --keep: the same for each file that was not removed.
    """

    def __init__(self, name: str, *options: str, syncs: int = 8, rate: float = 400.0) -> None:
        self.name = name
        self.promised = 0
        """How many items were promised in all cuts."""
        self.longest_ns = 0
        """The longest time that something was written for which no sync had begun."""
        self._options = options
        self._syncs = syncs
        self._rate = rate
        self._items: dict[bytes, list[str]] = {}

    def run(self, folder: Path, environment: Environment) -> None:
        sender = TapSender()
        log = str(folder / "x.mcap")
        command = ("sniff", sender.link, "-w", log, *self._options)
        running = Running(*command, environment=environment)
        try:
            running.await_line("listening on")
            sender.begin(self._rate)
            journal = Path(environment["POWER_CUTS_JOURNAL"])
            for _ in range(int(PATIENCE_S * 10)):
                records = records_of(journal.read_bytes())
                if (
                    sum(one.kind == "E" and one.path != str(folder) for one in records)
                    > self._syncs
                ):
                    break
                Event().wait(0.1)
        finally:
            running.end(signal.SIGINT)
            sender.stop()

    def wrong(self, cut: Cut) -> Iterator[str]:
        for number, file in enumerate(cut.disk.files):
            promised = self._read(file.promised)
            since_ns = cut.ns if file.waits_since_ns is None else file.waits_since_ns
            self.longest_ns = max(self.longest_ns, cut.ns - since_ns)
            if cut.is_over and file not in cut.disk.removed and file.promised != file.written:
                yield f"file {number} is closed and not synced"
            if file in cut.disk.removed or not promised:
                continue
            self.promised += len(promised)
            if file not in cut.places:
                yield f"file {number} is missing, with {len(promised)} items"
                continue
            found = self._read(cut.places[file].read_bytes())
            if found[: len(promised)] != promised:
                yield f"file {number}: of {len(promised)} items only {len(found)} are there"
            written = set(self._read(cut.final.files[number].written))
            if any(one not in written for one in found):
                yield f"file {number}: an item is in it that was never written"

    def _read(self, content: bytes) -> list[str]:
        if not content:
            return []
        if content not in self._items:
            items: list[str] = []
            with tempfile.NamedTemporaryFile(suffix=".mcap") as file:
                file.write(content)
                file.flush()
                with suppress(MbtoolError):  # It is raised behind all that can be read.
                    for item in read_log(file.name):
                        if not _is_damage(item):
                            items.append(repr(item))
            self._items[content] = items
        return self._items[content]


class KeptState(Program):
    """The state of a slave: a master that has got its response finds the value again."""

    name = "slave --state"
    _WRITE = "06 00f5"

    def __init__(self, writes: int = 30) -> None:
        self._writes = writes

    def run(self, folder: Path, environment: Environment) -> None:
        port = free_port()
        on = f"tcp:127.0.0.1:{port}"
        state = str(folder / "state.toml")
        running = Running(
            "slave", "fa3-at1m8x", "--on", on, "--state", state, environment=environment
        )
        try:
            running.await_line("Ctrl-C ends")
            with socket.create_connection(("127.0.0.1", port), PATIENCE_S) as master:
                for value in range(1, self._writes + 1):
                    adu = f"{value:04x} 0000 0006 01 {self._WRITE} {value:04x}"
                    master.sendall(bytes.fromhex(adu))
                    assert master.recv(64)[7] == 6
        finally:
            running.end(signal.SIGINT)

    def wrong(self, cut: Cut) -> Iterator[str]:
        form = re.compile(re.escape(bytes.fromhex(self._WRITE)) + rb"(..)", re.DOTALL)
        told = [int.from_bytes(value) for value in form.findall(b"".join(cut.told))]
        state = cut.image / "state.toml"
        if not state.exists():
            if told:
                yield "the state is missing"
            return
        kept = re.search(r"^00F5H = (\d+)\n", state.read_text(), re.MULTILINE)
        last = told[-1] if told else None
        right = (last, last + 1) if last is not None else (30, 1)
        if kept is None or int(kept[1]) not in right:
            yield f"the state has {kept and kept[1]}; the master was last told {last}"


class Replaced(Program):
    """A command that replaces a file: there is the old one or the new one, at the end the new."""

    def __init__(self, name: str, first: str, second: str) -> None:
        """Two commands in which {} is the file; the second one's power is cut."""
        self.name = name
        self._first, self._second = first, second

    def prepare(self, folder: Path) -> None:
        self._call(self._first, folder, dict(os.environ))

    def run(self, folder: Path, environment: Environment) -> None:
        self._call(self._second, folder, environment)

    def _call(self, command: str, folder: Path, environment: Environment) -> None:
        words = command.format(folder / "own.toml").split()
        subprocess.run(
            [sys.executable, "-m", "mbtool", *words],
            env=environment,
            check=True,
            capture_output=True,
            timeout=PATIENCE_S,
        )

    def wrong(self, cut: Cut) -> Iterator[str]:
        path = cut.image / "own.toml"
        left = path.read_bytes() if path.exists() else None
        old, new = cut.disk.files[0].before, cut.final.files[-1].written
        if left not in ((new,) if cut.is_over else (old, new)):
            yield f"the file is neither the old nor the new one, or not yet the new: {left!r:.60}"


class Repeated(Program):
    """Code that writes a file again and again: what it has printed is in it, or what comes next."""

    def __init__(self, name: str, file: str, code: str, times: int = 12) -> None:
        """`code` writes the text `number` into the file, which is in the folder `folder`."""
        self.name = name
        self._file = file
        self._program = (
            f"import pathlib, sys\nfolder = pathlib.Path(sys.argv[1])\nfor n in range({times}):\n"
            f"    number = f'number {{n}} '\n    {code}\n    print(n, flush=True)\n"
        )

    def run(self, folder: Path, environment: Environment) -> None:
        subprocess.run(
            [sys.executable, "-c", self._program, str(folder)],
            env=environment | {"XDG_CONFIG_HOME": str(folder)},
            check=True,
            capture_output=True,
            timeout=PATIENCE_S,
        )

    def wrong(self, cut: Cut) -> Iterator[str]:
        numbers = b"".join(cut.told).split()
        last = int(numbers[-1]) if numbers else -1
        path = cut.image / self._file
        left = re.search(r"number (\d+) ", path.read_text()) if path.exists() else None
        if (int(left[1]) if left else -1) not in (last, last + 1) or (path.exists() and not left):
            yield f"the file has {left and left[0]!r}; last written was {last}"


_LINE = CAPTURES / "ft1a-touch-line.mcap"


def all_programs() -> list[Program]:
    return [
        Recording("sniff -w"),
        Recording("sniff -w --rotate --keep", "--rotate", "20KB", "--keep", "3", syncs=20),
        KeptState(),
        Replaced(
            "devices draft -o --overwrite",
            f"devices draft {_LINE} -o {{}}",
            f"devices draft {CAPTURES / 'broadcast-write.mcap'} -o {{}} --overwrite",
        ),
        Replaced(
            "find --keep",
            f"find {_LINE} Speed=466.0rpm --keep {{}}",
            f"find {_LINE} Rate=4660 --keep {{}}",
        ),
        Repeated(
            "settings of watch",
            "mbtool/watch.json",
            "from mbtool.cli.watching.drawn_app import WatchSettings, save_settings; "
            "assert save_settings(WatchSettings(filters=[number])) is None",
        ),
        Repeated(
            "files of a cluster",
            "results/a.json",
            "from mbtool.cluster.store import OutputStore; "
            "OutputStore(str(folder)).put('results/a.json', number.encode())",
        ),
    ]


def _is_damage(item: object) -> bool:
    """True for the event that stands for a damaged part of a log."""
    return isinstance(item, WireEvent) and item.kind is EventKind.GAP and not item.link
