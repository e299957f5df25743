"""Finds the capture files that a user names: files, folders, and quoted patterns."""

# A folder stands for all captures in it and in its subfolders. Only files with the name of a
# capture (.pcap, .pcapng, .cap, .mcap) are taken, because a folder may hold other files; a text log
# or a file with the bytes of a serial line must be named by itself. A pattern stands for the files
# that match it. The files of a folder or pattern are sorted by name, and numbers in names are
# compared as numbers, so that site-2.pcap comes before site-10.pcap. If symbolic links give one
# file several names, it is taken once: under its own name if the same folder or pattern has it,
# otherwise under the first name.

from __future__ import annotations

import glob
import os
import re
from collections.abc import Sequence

from mbtool.core import InputError

_CAPTURE = re.compile(r".+\.(?:pcap|pcapng|cap|mcap|sr)\d*(?:\.gz|\.zst)?", re.IGNORECASE)
_WILD = re.compile(r"[*?\[]")
_NUMBER = re.compile(r"(\d+)")


def named_files(paths: Sequence[str]) -> list[str]:
    """Return the files that `paths` name, and each file of a folder or pattern once.

    A path that is no folder and no pattern stays as it is. Raises InputError for a folder without
    captures, and a pattern that no file fits.
    """
    found = [(path, _files_in(path)) for path in paths]
    taken = {os.path.realpath(path) for path, files in found if files is None}
    named: list[str] = []
    for path, files in found:
        if files is None:
            named.append(path)
            continue
        once: dict[str, str] = {}
        for file in sorted(files, key=lambda one: (os.path.islink(one), _order(one))):
            once.setdefault(os.path.realpath(file), file)
        named += sorted((file for real, file in once.items() if real not in taken), key=_order)
        taken |= once.keys()
    return named


def is_folder(path: str) -> bool:
    return os.path.isdir(path)


def _files_in(path: str) -> list[str] | None:
    """Return the files of a folder or a pattern; None if `path` is neither."""
    if is_folder(path):
        found = [
            file
            for folder, _, names in os.walk(path, onerror=_refuse_folder)
            for name in names
            if _CAPTURE.fullmatch(name) and os.path.isfile(file := os.path.join(folder, name))
        ]
        if not found:
            raise InputError(f"{path}: no capture in this folder: no .pcap, .pcapng, .cap, .mcap")
        return found
    if _WILD.search(path) and not os.path.lexists(path):
        found = [one for one in glob.glob(path, recursive=True) if os.path.isfile(one)]
        if not found:
            raise InputError(f"{path}: no file fits this pattern")
        return found
    return None


def _refuse_folder(error: OSError) -> None:
    raise InputError(f"{error.filename}: the folder cannot be read: {error.strerror}") from error


def _order(path: str) -> list[tuple[int, str]]:
    """Return a key that sorts names with the numbers in them as numbers."""
    return [
        (int(part), "") if number % 2 else (0, part)
        for number, part in enumerate(_NUMBER.split(path))
    ]
