"""Reads captures and writes results, on this machine or in object stores (pyarrow.fs)."""

# An address in an object store is s3://bucket/key, or any other form that pyarrow knows. The
# credentials come from the environment (AWS_PROFILE, AWS_ENDPOINT_URL and the like). A reader never
# sees a file that is only partly written: an object store shows only whole files, and on a disk a
# file gets its name when it is complete.

from __future__ import annotations

import glob
import hashlib
import os
import re
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any
from urllib.parse import quote

from pyarrow import fs

from mbtool.cluster.plan import InputFile
from mbtool.core import InputError, OutputError, UsageError
from mbtool.core.errors import reason_of
from mbtool.core.replacing import make_folder, move_into_place

_PIECE = 4 * 1024 * 1024
_ADDRESS = re.compile(r"([a-zA-Z][a-zA-Z0-9+.-]+)://([^/]*)/*(.*)", re.DOTALL)
_SYSTEM_REASON = re.compile(r"Detail: \[errno \d+\] (.+)")
"""The operating system's text for an error, in a message of pyarrow."""
_DEFAULT_REGION = "us-east-1"
"""The region to use for a store that is not Amazon's (AWS_ENDPOINT_URL), if none is set."""


def is_store_address(path: str) -> bool:
    """True if a path is an address in an object store, such as s3://bucket/key."""
    return _ADDRESS.fullmatch(path) is not None


def list_inputs(pattern: str) -> list[InputFile]:
    """List the files that a path, an address or a pattern with * names, sorted by name.

    Raises InputError if there is none, and UsageError for an address of an unknown kind.
    """
    if os.path.isdir(pattern):
        raise InputError(f"{pattern}: a directory; name captures in it: '{pattern}/*.pcap'")
    found = _remote_files(pattern) if is_store_address(pattern) else _local_files(pattern)
    if not found:
        raise InputError(f"{pattern}: there is no such file")
    return found


def fetch(file: InputFile, copy: Path, most: int | None = None) -> tuple[str, str]:
    """Return the path at which a file can be read, and the SHA-256 of its bytes.

    A file of an object store is copied to the path `copy`. If a file has more than `most` bytes,
    only its first `most` bytes are copied. Raises InputError if it cannot be read.
    """
    is_cut = most is not None and file.size > most
    try:
        with _stream(file.path) as stream:
            if not is_store_address(file.path) and not is_cut:
                return file.path, hashlib.file_digest(stream, "sha256").hexdigest()
            digest, left = hashlib.sha256(), most if is_cut else None
            with copy.open("wb") as local:
                while piece := stream.read(_PIECE if left is None else min(_PIECE, left)):
                    digest.update(piece)
                    local.write(piece)
                    left = None if left is None else left - len(piece)
    except OSError as error:
        raise InputError(f"{file.path}: cannot be read: {_reason(error)}") from error
    return str(copy), digest.hexdigest()


def _stream(path: str) -> Any:
    """Open a file for reading, on this machine or in an object store."""
    if not is_store_address(path):
        return open(path, "rb")
    store, place = _open_store(path)
    return store.open_input_stream(place, compression=None)


class OutputStore:
    """The folder, or the prefix in an object store, that results are written to.

    Its methods raise OutputError if the folder cannot be used; `make` raises UsageError.
    """

    def __init__(self, address: str) -> None:
        """`address` is a folder, or a prefix in an object store such as s3://bucket/prefix.

        Raises UsageError for an address of an unknown kind.
        """
        self.address = address.rstrip("/") or "/"
        self._is_local = not is_store_address(address)
        if self._is_local:
            self._fs, self._root = fs.LocalFileSystem(), os.path.abspath(address)
        else:
            self._fs, self._root = _open_store(self.address)

    def make(self, folder: str) -> None:
        """Make a folder, with those above it, if it is missing. An object store needs none.

        Raises UsageError if that is not possible.
        """
        if not self._is_local:
            return
        try:
            make_folder(Path(self._root) / folder)
        except (OSError, ValueError) as error:
            text = f"{self.address}: this folder cannot be made: {_reason(error)}"
            raise UsageError(text) from error

    def names(self, folder: str) -> list[str]:
        """The names of the files in a folder; none if there is no such folder."""
        with self._guarded():
            chosen = fs.FileSelector(f"{self._root}/{folder}", allow_not_found=True)
            return [one.base_name for one in self._fs.get_file_info(chosen) if one.is_file]

    def read(self, name: str) -> bytes:
        """The content of a file; empty if there is no such file."""
        with (
            self._guarded(),
            suppress(FileNotFoundError),
            self._fs.open_input_stream(f"{self._root}/{name}") as stream,
        ):
            data: bytes = stream.read()
            return data
        return b""

    def put(self, name: str, data: bytes | Path) -> None:
        """Write a file with the name `name`.

        `data` is its content, or the path of a file on this machine that has the content.
        """
        path = f"{self._root}/{name}"
        folder, _, base = path.rpartition("/")
        # If this process is killed, the unfinished file stays. Readers of Parquet ignore files
        # whose name begins with a dot.
        begun = f"{folder}/.{base}.{os.getpid()}.part" if self._is_local else path
        with self._guarded():
            if self._is_local:
                make_folder(Path(folder))
            self._write(begun, data)
            if begun != path:
                move_into_place(Path(begun), Path(path))

    def delete(self, name: str) -> None:
        """Delete a file; do nothing if it does not exist."""
        with self._guarded(), suppress(FileNotFoundError):
            self._fs.delete_file(f"{self._root}/{name}")

    def _write(self, path: str, data: bytes | Path) -> None:
        with self._fs.open_output_stream(path, compression=None) as stream:
            if isinstance(data, bytes):
                stream.write(data)
                return
            with data.open("rb") as file:
                while piece := file.read(_PIECE):
                    stream.write(piece)

    @contextmanager
    def _guarded(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            raise OutputError(f"{self.address}: cannot be written: {_reason(error)}") from error


def _local_files(pattern: str) -> list[InputFile]:
    try:
        # If a file has exactly this name, a * in it is part of the name, not a wildcard.
        names = [pattern] if os.path.lexists(pattern) else sorted(glob.glob(pattern))
        states = [(os.path.abspath(name), os.stat(name)) for name in names]
    except (OSError, ValueError) as error:
        raise InputError(f"{pattern}: cannot be read: {_reason(error)}") from error
    return [
        InputFile(name, state.st_size, state.st_mtime_ns)
        for name, state in states
        if not stat.S_ISDIR(state.st_mode)
    ]


def _remote_files(pattern: str) -> list[InputFile]:
    """List the files of an object store that match a pattern with *.

    This lists the folders level by level, and only those that match, because a store may have very
    many others.
    """
    store, path = _open_store(pattern)
    folders, *parts = path.split("/")
    begin = pattern.partition("://")[0]
    inside = [fs.FileInfo(folders, fs.FileType.Directory)]
    try:
        for part in parts:
            fits = re.compile(".*".join(map(re.escape, part.split("*"))), re.DOTALL).fullmatch
            inside = [
                one
                for folder in inside
                if folder.type is fs.FileType.Directory
                for one in store.get_file_info(fs.FileSelector(folder.path, allow_not_found=True))
                if fits(one.base_name)
            ]
    except OSError as error:
        raise InputError(f"{pattern}: cannot be listed: {_reason(error)}") from error
    files = sorted((one for one in inside if one.is_file), key=lambda one: one.path)
    return [InputFile(f"{begin}://{one.path}", one.size, one.mtime_ns or 0) for one in files]


def _open_store(address: str) -> tuple[Any, str]:
    """Connect to the object store of an address; return the store, and the path in it.

    Raises UsageError for an address of an unknown kind.
    """
    match = _ADDRESS.fullmatch(address)
    assert match is not None
    scheme, bucket, path = match.groups()
    try:
        store, _ = fs.FileSystem.from_uri(f"{scheme}://{bucket}{_options(scheme)}")
    except (OSError, ValueError) as error:
        raise UsageError(f"{address}: {_reason(error)}") from error
    return store, f"{bucket}/{path}".rstrip("/")


def _options(scheme: str) -> str:
    """Return the query, beginning with `?`, to append to a store's address; empty if not s3.

    If AWS_ENDPOINT_URL names a store that is not Amazon's, the query has this server and the region
    in AWS_REGION: pyarrow does not take them from the environment itself.
    """
    endpoint = os.environ.get("AWS_ENDPOINT_URL_S3") or os.environ.get("AWS_ENDPOINT_URL")
    if scheme != "s3":
        return ""
    once = "?allow_delayed_open=true"  # A small file is then written by one request, not three.
    if not endpoint:
        return once
    region = os.environ.get("AWS_REGION") or os.environ.get("AWS_DEFAULT_REGION")
    way, _, place = endpoint.rpartition("://")
    return (
        f"{once}&endpoint_override={quote(place, safe='')}&scheme={way or 'https'}"
        f"&region={region or _DEFAULT_REGION}"
    )


def _reason(error: OSError | ValueError) -> str:
    """The reason of an error of a library or the operating system, in one line."""
    text = " ".join(reason_of(error).split())
    system = _SYSTEM_REASON.search(text)
    return text if system is None else system[1]
