"""A disk that loses power: makes of a journal what may be left in a folder."""

# What a program may rely on, and no more: the content that a file had when a sync of it began is on
# the disk when the sync has ended; names that were given, changed or removed in a folder before a
# sync of the folder began, when that has ended. Of all else anything may be left: of a file's
# content each piece of 512 or 4096 bytes as it was after any of the writes, its length after any of
# them (bytes without content are zeros), and of a folder's changes the first ones.

from __future__ import annotations

import io
import struct
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from random import Random

_HEAD = struct.Struct("<cqqq")
_LENGTH = struct.Struct("<I")
PIECES = (512, 4096)


class Record(NamedTuple):
    """One record of the journal (journal.c)."""

    kind: str
    ns: int
    first: int
    second: int
    path: str
    other: str
    data: bytes


def records_of(journal: bytes) -> list[Record]:
    """Read a journal; a record that is still being written is left out."""
    stream = io.BytesIO(journal)
    records = []

    def text() -> str:
        return stream.read(*_LENGTH.unpack(stream.read(_LENGTH.size))).decode()

    while len(head := stream.read(_LENGTH.size)) == _LENGTH.size:
        end = stream.tell() + _LENGTH.unpack(head)[0]
        if end > len(journal):
            break
        kind, ns, first, second = _HEAD.unpack(stream.read(_HEAD.size))
        path, other = text(), text()
        data = stream.read(end - stream.tell())
        records.append(Record(kind.decode(), ns, first, second, path, other, data))
    return records


@dataclass(eq=False)
class Synced:
    """Changes of a file or folder, and how many of them a sync that has ended covers."""

    changes: list[Record] = field(default_factory=list)
    covered: int = 0
    _begun: dict[int, int] = field(default_factory=dict)

    def note(self, record: Record) -> None:
        if record.kind == "B":
            self._begun[record.second] = len(self.changes)
        elif record.kind == "E":
            self.covered = max(self.covered, self._begun.pop(record.second))
        else:
            self.changes.append(record)


@dataclass(eq=False)
class File(Synced):
    """A file, whatever its name is."""

    before: bytes = b""
    """The content when the journal began, which is on the disk."""

    @property
    def promised(self) -> bytes:
        """What it held when the last sync that has ended began."""
        return self._after(self.covered)

    @property
    def written(self) -> bytes:
        """What the program has written."""
        return self._after(len(self.changes))

    @property
    def waits_since_ns(self) -> int | None:
        """When the first change was written that no sync covers which has begun; None if none."""
        covered = max(self.covered, *self._begun.values(), 0)
        return self.changes[covered].ns if covered < len(self.changes) else None

    def left(self, chance: Random) -> bytes:
        """What may be left of it."""
        piece = chance.choice(PIECES)
        count = len(self.changes)
        kept = chance.choice(("first", "last", "any", "any"))

        def drawn() -> int:
            bounds = {"first": (self.covered, self.covered), "last": (count, count)}
            return chance.randint(*bounds.get(kept, (self.covered, count)))

        length = len(self._after(drawn()))
        wanted: dict[int, list[int]] = {}
        for at in range(0, length, piece):
            wanted.setdefault(drawn(), []).append(at)
        content = bytearray(length)
        now = bytearray(self._after(self.covered))
        for number in range(self.covered, count + 1):
            if number > self.covered:
                _apply(now, self.changes[number - 1])
            for at in wanted.get(number, ()):
                part = now[at : min(at + piece, length)]
                content[at : at + len(part)] = part
        return bytes(content)

    def _after(self, count: int) -> bytes:
        content = bytearray(self.before)
        for change in self.changes[:count]:
            _apply(content, change)
        return bytes(content)


class Disk:
    """A folder whose power is cut."""

    def __init__(self, root: Path) -> None:
        """`root` is the folder as it is when the journal begins; all of it is on the disk."""
        self.root = str(root)
        self.files: list[File] = []
        """Every file that there has been."""
        self.removed: set[File] = set()
        """Files whose last name the program has removed or given to another file."""
        self._by_inode: dict[int, File] = {}
        self._names: dict[str, File | None] = {self.root: None}
        """The names as the program sees them; None stands for a folder."""
        self._folders: dict[str, Synced] = {self.root: Synced()}
        self._given: dict[int, File] = {}
        """By the identity of the record that has named it: the file."""
        for path in sorted(root.rglob("*")):
            if path.is_dir():
                self._names[str(path)] = None
                self._folders[str(path)] = Synced()
            else:
                file = File(before=path.read_bytes())
                self.files.append(file)
                self._by_inode[path.stat().st_ino] = self._names[str(path)] = file
        self._before = dict(self._names)

    def note(self, record: Record) -> None:
        """Take over the next record."""
        kind, path = record.kind, record.path
        if kind in "OUDR":
            self._change_names(record)
        elif path in self._folders:
            self._folders[path].note(record)
        elif record.first in self._by_inode:
            self._by_inode[record.first].note(record)

    def _change_names(self, record: Record) -> None:
        kind, path = record.kind, record.path
        folder = str(Path(path).parent)
        self._folders[folder].note(record)
        if kind == "D":
            self._names[path] = None
            self._folders[path] = Synced()
        elif kind == "O":
            file = self._by_inode[record.first] = self._names[path] = File()
            self.files.append(file)
            self._given[id(record)] = file
        else:
            file_or_none = self._names.pop(path)
            assert file_or_none is not None
            file = file_or_none
            lost = self._names.get(record.other) if kind == "R" else file
            if lost is not None:
                self.removed.add(lost)
            if kind == "R":
                assert str(Path(record.other).parent) == folder
                self._names[record.other] = file

    def cut(self, chance: Random, image: Path) -> dict[File, Path]:
        """Make the folder `image` as it may be after a power cut; return where each file is."""
        names = dict(self._before)
        for folder in self._folders.values():
            some = chance.randint(folder.covered, len(folder.changes))
            count = chance.choice((folder.covered, some, len(folder.changes)))
            for change in folder.changes[:count]:
                if change.kind == "D":
                    names[change.path] = None
                elif change.kind == "O":
                    names[change.path] = self._given[id(change)]
                elif change.kind == "R":
                    names[change.other] = names.pop(change.path)
                else:
                    del names[change.path]
        image.mkdir()
        places = {}
        for name, file in sorted(names.items(), key=lambda one: one[0]):
            place = image / Path(name).relative_to(self.root)
            if not place.parent.is_dir():
                continue  # Its folder is lost, and all in it.
            if file is None:
                place.mkdir(exist_ok=True)
            else:
                place.write_bytes(file.left(chance))
                places[file] = place
        return places


def _apply(content: bytearray, change: Record) -> None:
    end = change.second if change.kind == "T" else change.second + len(change.data)
    if len(content) < end:
        content.extend(bytes(end - len(content)))
    if change.kind == "T":
        del content[end:]
    else:
        content[change.second : end] = change.data
