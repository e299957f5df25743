"""Saves the transactions that the user of a live view marked or filtered, as a log or a capture."""

# If the view shows files, or if a log is being written, the original packets and bytes are copied
# from there (convert.py). Otherwise a log is made from the frames of the transactions that the view
# still has in memory, each frame with the time of its last byte. It lacks the bytes between frames.

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path, PurePath
from typing import TYPE_CHECKING, Protocol

from mbtool.core import Chunk, Direction, UsageError, WireEvent
from mbtool.core.evidence import Connection, Endpoint, Stamp
from mbtool.core.moments import counted
from mbtool.workflows.convert import CAPTURE_SUFFIXES, Conversion
from mbtool.workflows.shared.reading_options import ReadingOptions
from mbtool.workflows.shared.time_window import TimeWindow

if TYPE_CHECKING:
    from mbtool.devices import NamedTransaction
    from mbtool.logs import LogWriter, RotatingLog
    from mbtool.watching.watched import Watched

    Job = Callable[[], str]

_LOG_SUFFIX = ".mcap"


class Saver(Protocol):
    """Saves transactions of a view: those that the user marked. If none is marked, those that the
    user's filter accepts; without a filter, all.
    """

    def what(self, watched: Watched, *, is_filtered: bool) -> str:
        """Return a text for the user that says which transactions `job` would save. `is_filtered`
        is True if the user's filter is on.
        """

    def job(self, watched: Watched, *, is_filtered: bool, out: str) -> Job:
        """Return a function that saves transactions to the file `out`. It is called in another
        thread, as saving may take long. `is_filtered` is True if the user's filter is on.

        That function returns a line for the user. It raises UsageError if the file cannot be
        created, OutputError if writing fails.
        """


class EvidenceSaver:
    """Saves the original packets and bytes of transactions, from the files in the view or the log
    being written.
    """

    def __init__(self, paths: Sequence[str], options: ReadingOptions | None = None) -> None:
        self._paths = paths
        self._options = options or ReadingOptions()

    def what(self, watched: Watched, *, is_filtered: bool) -> str:
        return _marked_text(watched) or ("what passes the filter" if is_filtered else "everything")

    def job(self, watched: Watched, *, is_filtered: bool, out: str) -> Job:
        wanted = watched.wanted if is_filtered else None
        marked = _marked(watched)
        if marked:
            keys = {_identity(one) for one in marked}

            def wanted(one: NamedTransaction) -> bool:
                return _identity(one) in keys

        def save() -> str:
            _demand_new(out)
            return _convert(self._paths, self._options, wanted, out)

        return save


class FrameSaver:
    """Saves the frames of transactions that the view has in memory. It is used if there is no log
    or file.
    """

    def __init__(self, begin_log: Callable[[str], LogWriter | RotatingLog]) -> None:
        """`begin_log` creates a log at the path that is its argument, with the links and devices of
        the view.
        """
        self._begin_log = begin_log

    def what(self, watched: Watched, *, is_filtered: bool) -> str:
        text = _marked_text(watched)
        if text:
            return text
        return "the last ones that pass" if is_filtered else "the last transactions"

    def job(self, watched: Watched, *, is_filtered: bool, out: str) -> Job:
        board = watched.filtered if is_filtered and watched.filtered else watched.whole
        kept = watched.marked.values() if _marked(watched) else board.records
        listed = {one.order: one.record for one in kept if not isinstance(one.record, WireEvent)}
        chosen = [*listed.values()]
        chosen.sort(key=lambda one: one.start_ns)
        damaged = {
            _identity(listed[order]): event
            for order, event in watched.whole.damaged.items()
            if order in listed and not event.source
        }

        def save() -> str:
            _demand_new(out)
            if PurePath(out).suffix.lower() == _LOG_SUFFIX:
                self._write(out, chosen, damaged)
                return f"{counted(len(chosen), 'transaction')} -> {out}"
            with tempfile.TemporaryDirectory() as folder:
                log = str(Path(folder) / "frames.mcap")
                self._write(log, chosen, damaged)
                return _convert([log], ReadingOptions(), None, out)

        return save

    def _write(
        self,
        path: str,
        chosen: Sequence[NamedTransaction],
        damaged: Mapping[tuple[object, ...], WireEvent],
    ) -> None:
        """Write the chosen transactions to a log, each with the frame in `damaged` that was its
        response.
        """
        log = self._begin_log(path)
        try:
            for one in chosen:
                for chunk in _chunks(one):
                    log.write(chunk)
                event = damaged.get(_identity(one))
                if event is not None:
                    log.write(Chunk(ts_ns=event.ts_ns, link=event.link, data=event.raw))
                    log.write(event)
                log.write(one)
        finally:
            log.close({})


def _convert(
    paths: Sequence[str],
    options: ReadingOptions,
    wanted: Callable[[NamedTransaction], bool] | None,
    out: str,
) -> str:
    done = Conversion(paths, options, TimeWindow(None, None), wanted).write(out)
    parts = ((done.transactions, "transaction"), (done.packets, "packet"), (done.reads, "read"))
    texts = [counted(count, word) for count, word in parts if count]
    return f"{', '.join(texts) or 'nothing'} -> {out}"


def _demand_new(out: str) -> None:
    """Raise UsageError unless the name is that of a capture, and no file has it."""
    if PurePath(out).suffix.lower() not in CAPTURE_SUFFIXES:
        raise UsageError(f"{out}: let it end in .mcap, .pcapng or .pcap")
    if os.path.isfile(out):
        raise UsageError(f"{out}: the file exists; name another")


def _marked(watched: Watched) -> list[NamedTransaction]:
    return [one.record for one in watched.marked.values() if not isinstance(one.record, WireEvent)]


def _marked_text(watched: Watched) -> str:
    count = len(_marked(watched))
    return counted(count, "marked transaction") if count else ""


def _identity(one: NamedTransaction) -> tuple[object, ...]:
    """Return the fields that identify a transaction in its capture, so that it is found when the
    capture is decoded again.
    """
    return one.request_ns, one.response_ns, one.unit, one.function, one.request_raw


def _chunks(one: NamedTransaction) -> Iterator[Chunk]:
    """Yield the request and the response of a transaction, each as a chunk (one read of a port)."""
    ends = _connection_of(one)
    for raw, ts_ns, direction in (
        (one.request_raw, one.request_ns, Direction.REQUEST),
        (one.response_raw, one.response_ns, Direction.RESPONSE),
    ):
        if raw is not None and ts_ns is not None:
            yield Chunk(
                ts_ns=ts_ns,
                link=one.link,
                data=raw,
                direction=Direction.UNKNOWN if ends is None else direction,
                stamp=Stamp.LAST_BYTE if ends is None else Stamp.AT_ONCE,
                connection=ends,
            )


def _connection_of(one: NamedTransaction) -> Connection | None:
    master, slave = _endpoint(one.source), _endpoint(one.destination)
    return None if master is None or slave is None else Connection(master, slave)


def _endpoint(text: str | None) -> Endpoint | None:
    host, _, port = (text or "").rpartition(":")
    return Endpoint(host.strip("[]"), int(port)) if host and port.isdecimal() else None
