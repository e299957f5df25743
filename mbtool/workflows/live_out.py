"""Reports the traffic of a recording to other programs: MQTT, metrics, commands for troubles."""

# The recording never waits for MQTT, metrics or commands. Another thread writes the bytes to the
# log. A thread of the publisher takes the values and sends them by MQTT. A thread of the server
# returns the text of the metrics. A command runs as a process of its own. Metrics and commands need
# the list of troubles: it is computed at most once a second, and in at most 1 / SHARE of the time.

from __future__ import annotations

import json
import os
import re
import subprocess
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from hashlib import blake2b
from typing import TYPE_CHECKING, Self, TypeAlias

from mbtool.core import UsageError, WireEvent
from mbtool.logs.points import PointChanges
from mbtool.logs.rotation import RotatingLog
from mbtool.ports.clock import now_ns
from mbtool.troubles.words import WORDS
from mbtool.views.openmetrics import openmetrics
from mbtool.views.trouble_lines import trouble_text

if TYPE_CHECKING:
    from mbtool.decode.decoder import Record
    from mbtool.devices import NamedTransaction
    from mbtool.logs.messages import PointMessage
    from mbtool.logs.writer import LogWriter
    from mbtool.ports.metrics_server import MetricsServer
    from mbtool.ports.mqtt import MqttPublisher
    from mbtool.troubles.trouble import Trouble
    from mbtool.workflows.stats import LiveStatistics

Key: TypeAlias = tuple[str, str, int | None, str]
"""The code, link, unit and master of a trouble, by which it is known again."""

REFRESH_NS = 1_000_000_000
SHARE = 20
MAX_RUNNING = 4
"""At most this many commands run at one time; a trouble that comes meanwhile waits."""
MAX_ANNOUNCED = 65_536
"""After this many topics, all are forgotten, and each is announced to Home Assistant again."""
DISCOVERY = "homeassistant"
"""The topic below which Home Assistant looks for devices."""
_NO_ID = re.compile(r"[^A-Za-z0-9_-]+")


class LiveOut:
    """Passes on what is heard to a broker, to those who fetch metrics, and to commands."""

    def __init__(
        self,
        publisher: MqttPublisher | None,
        server: MetricsServer | None,
        commands: Sequence[tuple[str, str]],
        on_remark: Callable[[str], None],
        kept_codes: Sequence[str] = (),
    ) -> None:
        """`commands` are pairs of the beginning of a trouble's code and a command of the shell.

        `kept_codes` are the beginnings of the codes of troubles around which the log is kept.
        """
        self._values = None if publisher is None else PublishedValues(publisher)
        self._publisher = publisher
        self._server = server
        self._commands = None if not commands else TroubleCommands(commands, on_remark)
        self._kept = KeptFiles(kept_codes) if kept_codes else None
        self._opened = ExitStack()
        self._next_ns = 0

    def __enter__(self) -> Self:
        with ExitStack() as opened:
            for one in (self._publisher, self._server):
                if one is not None:
                    opened.enter_context(one)
            self._opened = opened.pop_all()
        return self

    def __exit__(self, *_: object) -> None:
        self._opened.close()

    def take(self, record: Record) -> None:
        """Pass on a transaction's values."""
        if self._values is not None and not isinstance(record, WireEvent):
            self._values.take(record)

    @property
    def metrics_place(self) -> str | None:
        """The address at which metrics are served; None if they are not."""
        return None if self._server is None else self._server.place

    def keep_files_of(
        self, create: Callable[[], LogWriter | RotatingLog]
    ) -> LogWriter | RotatingLog:
        """Call `create`, and return its log; if it is rotated, files are kept around troubles."""
        log = create()
        if self._kept is not None and isinstance(log, RotatingLog):
            self._kept.log = log
        return log

    def look(self, at_ns: int, live: LiveStatistics) -> None:
        """Judge, if it is time again, and pass on the metrics and the troubles."""
        users = (self._server, self._commands, self._kept)
        if all(one is None for one in users) or at_ns < self._next_ns:
            return
        live.advance(at_ns)
        judged = live.judgement()
        if self._server is not None:
            self._server.text = openmetrics(judged).encode()
        if self._commands is not None:
            self._commands.take(judged.troubles)
        if self._kept is not None:
            self._kept.take(judged.troubles)
        done_ns = now_ns()
        self._next_ns = done_ns + max(REFRESH_NS, SHARE * (done_ns - at_ns))


class PublishedValues:
    """Publishes named values when they change, and says to Home Assistant what they are."""

    # Memory: MAX_ANNOUNCED topics, and what PointChanges keeps.

    def __init__(self, publisher: MqttPublisher) -> None:
        self._publisher = publisher
        self._changes = PointChanges()
        self._announced: set[str] = set()

    def take(self, transaction: NamedTransaction) -> None:
        """Publish the values of a transaction that differ from those before."""
        ts_ns = transaction.response_ns or transaction.start_ns
        for point in self._changes.changes(transaction, ts_ns):
            topic = f"{_part(point.link)}/unit_{point.unit_id}/{_part(point.name)}"
            if len(self._announced) >= MAX_ANNOUNCED:
                self._announced.clear()
            if topic not in self._announced:
                self._announced.add(topic)
                self._announce(point, topic)
            payload = {
                "value": point.text if point.value is None else point.value,
                "text": point.text,
                "ts_ns": point.ts_ns,
            }
            self._publisher.publish(topic, json.dumps(payload).encode(), retain=True)

    def _announce(self, point: PointMessage, topic: str) -> None:
        prefix = self._publisher.prefix
        device = f"{_part(point.link)}_{point.unit_id}"
        identity = f"{_id(prefix)}_{_id(device)}_{_id(point.name)}"
        config = {
            "name": point.name,
            "unique_id": identity,
            "state_topic": f"{prefix}/{topic}",
            "value_template": "{{ value_json.value }}",
            "availability_topic": f"{prefix}/status",
            "device": {
                "identifiers": [f"{_id(prefix)}_{_id(device)}"],
                "name": f"{point.link} unit {point.unit_id}",
                **({} if point.device is None else {"model": point.device}),
            },
        }
        if point.unit is not None:
            config["unit_of_measurement"] = point.unit
        where = f"{DISCOVERY}/sensor/{identity}/config"
        self._publisher.publish_at(where, json.dumps(config).encode(), retain=True)


class KeptFiles:
    """Keeps the files of a rotated log around troubles: where one begins, and where it comes again
    after a whole file without a case.
    """

    def __init__(self, codes: Sequence[str]) -> None:
        """`codes` are the beginnings of the codes of these troubles.

        Raises UsageError if no code of a trouble begins like one of them.
        """
        for code in codes:
            _check_code(code, "--keep-around")
        self._codes = tuple(codes)
        self._cases: dict[Key, tuple[int, int]] = {}
        """By trouble, the number of its cases, and the number of the file with the last one."""
        self.log: RotatingLog | None = None

    def take(self, troubles: Sequence[Trouble]) -> None:
        """Keep the present file and its neighbours if a trouble begins or has come again."""
        if self.log is None:
            return
        number = self.log.number
        for trouble in (each for one in troubles for each in one.all):
            if trouble.code.startswith(self._codes):
                key = _key_of(trouble)
                count, last = self._cases.get(key, (0, -1))
                if trouble.count > count:
                    self._cases[key] = trouble.count, number
                    if last < 0 or number > last + 1:
                        self.log.keep_around()


class TroubleCommands:
    """Runs a command of the user when a trouble is reported for the first time."""

    def __init__(
        self, commands: Sequence[tuple[str, str]], on_remark: Callable[[str], None]
    ) -> None:
        """Raises UsageError if no code of a trouble begins like the first of a pair."""
        for code, _ in commands:
            _check_code(code, "--on")
        self._commands = commands
        self._on_remark = on_remark
        self._told: set[Key] = set()
        self._running: list[subprocess.Popen[bytes]] = []

    def take(self, troubles: Sequence[Trouble]) -> None:
        """Run the commands for troubles that were not reported before."""
        self._running = [one for one in self._running if one.poll() is None]
        for trouble in (each for one in troubles for each in one.all):
            key = _key_of(trouble)
            fitting = [line for code, line in self._commands if trouble.code.startswith(code)]
            if key in self._told or not fitting:
                continue
            if len(self._running) + len(fitting) > max(MAX_RUNNING, len(fitting)):
                return
            self._told.add(key)
            for line in fitting:
                self._run(line, trouble)

    def _run(self, line: str, trouble: Trouble) -> None:
        about = {
            "MBTOOL_CODE": trouble.code,
            "MBTOOL_LINK": trouble.link,
            "MBTOOL_UNIT": "" if trouble.unit is None else str(trouble.unit),
            "MBTOOL_MASTER": trouble.master,
            "MBTOOL_TEXT": trouble_text(trouble),
        }
        try:
            # The user wrote `line` for a shell. Texts from a capture are only in its environment,
            # so they cannot change the command.
            process = subprocess.Popen(
                line,
                shell=True,
                env={**os.environ, **about},
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
                start_new_session=True,
            )
        except OSError as error:
            self._on_remark(f"--on {trouble.code}: the command cannot be run: {error}")
        else:
            self._running.append(process)


def _check_code(code: str, option: str) -> None:
    if not any(one.startswith(code) for one in WORDS):
        raise UsageError(f"{option} {code}: no trouble has such a code; docs/troubles.md")


def _key_of(trouble: Trouble) -> Key:
    return trouble.code, trouble.link, trouble.unit, trouble.master


def _part(text: str) -> str:
    """Return a text as one level of a topic: without the characters that mean something there."""
    return re.sub(r"[/+#\x00-\x1f]", "_", text).strip() or "_"


def _id(text: str) -> str:
    """Return a text as a part of an id, which no other text has."""
    plain = _NO_ID.sub("_", text)
    if plain == text:
        return text
    return f"{plain}_{blake2b(text.encode(errors='replace'), digest_size=4).hexdigest()}"
