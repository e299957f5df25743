"""Captures and results on this machine and in object stores (pyarrow.fs)."""

# An address is a path, or s3://bucket/key and what else pyarrow knows. The credentials are those of
# the environment (AWS_PROFILE, AWS_ENDPOINT_URL and the like). A file that is written appears under
# its name as a whole: in an object store by the store itself, on a disk by renaming.

from __future__ import annotations

import glob
import hashlib
import os
import re
import stat
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING, Any
from urllib.parse import quote

from pyarrow import fs

from mbtool.cluster.plan import InputFile
from mbtool.core import InputError, OutputError, UsageError

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

_PIECE = 4 * 1024 * 1024
_ADDRESS = re.compile(r"([a-zA-Z][a-zA-Z0-9+.-]+)://([^/]*)/*(.*)", re.DOTALL)
_DEFAULT_REGION = "us-east-1"
"""The region of a store of one's own, whose address is in AWS_ENDPOINT_URL."""


def is_address(path: str) -> bool:
    """True for a path in an object store."""
    return _ADDRESS.fullmatch(path) is not None


def list_inputs(pattern: str) -> list[InputFile]:
    """The files of a path, an address, or a pattern with *, in the order of their names.

    Raises InputError if there is none, UsageError for an address of an unknown kind.
    """
    if os.path.isdir(pattern):
        raise InputError(f"{pattern}: a directory; name captures in it: '{pattern}/*.pcap'")
    found = _remote_files(pattern) if is_address(pattern) else _local_files(pattern)
    if not found:
        raise InputError(f"{pattern}: there is no such file")
    return found


def fetch(file: InputFile, copy: Path, most: int | None = None) -> tuple[str, str]:
    """The path at which a file can be read, and the SHA-256 of its bytes.

    A file of an object store is copied to `copy`; of any file only the beginning, if it has more
    bytes than `most`. Raises InputError.
    """
    is_cut = most is not None and file.size > most
    try:
        with _stream(file.path) as stream:
            if not is_address(file.path) and not is_cut:
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
    """Open a file for reading, here or in an object store."""
    if not is_address(path):
        return open(path, "rb")
    store, place = _opened(path)
    return store.open_input_stream(place, compression=None)


class OutputStore:
    """The folder or prefix that results are written to. Its methods raise OutputError."""

    def __init__(self, address: str) -> None:
        """Raises UsageError for an address of an unknown kind."""
        self.address = address.rstrip("/") or "/"
        self._is_local = not is_address(address)
        if self._is_local:
            self._fs, self._root = fs.LocalFileSystem(), os.path.abspath(address)
        else:
            self._fs, self._root = _opened(self.address)

    def names(self, folder: str) -> list[str]:
        """The names of the files in a folder; none if there is no such folder."""
        with self._guarded():
            chosen = fs.FileSelector(f"{self._root}/{folder}", allow_not_found=True)
            return [one.base_name for one in self._fs.get_file_info(chosen) if one.is_file]

    def read(self, name: str) -> bytes:
        """The bytes of a file; none if it is not there."""
        with (
            self._guarded(),
            suppress(FileNotFoundError),
            self._fs.open_input_stream(f"{self._root}/{name}") as stream,
        ):
            data: bytes = stream.read()
            return data
        return b""

    def put(self, name: str, data: bytes | Path) -> None:
        """Write a file: bytes, or what is in a file of this machine."""
        path = f"{self._root}/{name}"
        folder, _, base = path.rpartition("/")
        # If this process is killed, the part stays; readers of Parquet leave out such names.
        begun = f"{folder}/.{base}.{os.getpid()}.part" if self._is_local else path
        with self._guarded():
            if self._is_local:
                self._fs.create_dir(folder)
            self._write(begun, data)
            if begun != path:
                os.replace(begun, path)

    def delete(self, name: str) -> None:
        """Delete a file, if it is there."""
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
        # A name may have a star of its own.
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
    """Look into one level of folders after the other, so that no other folder is listed."""
    store, path = _opened(pattern)
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


def _opened(address: str) -> tuple[Any, str]:
    """The object store of an address, and the path in it."""
    match = _ADDRESS.fullmatch(address)
    assert match is not None
    scheme, bucket, path = match.groups()
    try:
        store, _ = fs.FileSystem.from_uri(f"{scheme}://{bucket}{_options(scheme)}")
    except (OSError, ValueError) as error:
        raise UsageError(f"{address}: {_reason(error)}") from error
    return store, f"{bucket}/{path}".rstrip("/")


def _options(scheme: str) -> str:
    """What pyarrow does not take from the environment itself: a store that is not Amazon's."""
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
    """What a library says, in one line."""
    return " ".join(str(error).split())
