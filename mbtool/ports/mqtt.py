"""Publishes messages to an MQTT broker, and never makes the caller wait."""

# The caller puts messages into a dictionary by topic; a newer message for a topic takes the place
# of one that was not sent yet, so that the broker gets the latest state. A thread of this module
# takes them out, publishes each with QoS 1, and waits until the broker has confirmed it. So a slow
# broker slows only this thread; while the broker is away, messages wait in the dictionary. paho has
# another thread, which connects again by itself, and then sends unconfirmed messages again. A
# broker that was restarted may have lost the messages that it retained, so the latest message of
# each topic is published again after each new connection.
#
# Memory: MAX_WAITING messages that wait, and as many retained ones. Beyond that, the oldest one is
# dropped, and counted if it has not been sent.

from __future__ import annotations

import os
import re
import ssl
import threading
from collections import OrderedDict
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from importlib.util import find_spec
from typing import Any
from urllib.parse import parse_qs, unquote, urlsplit

from mbtool.core import LinkError, UsageError
from mbtool.core.extras import missing_extra

MAX_WAITING = 65_536
PASSWORD = "MBTOOL_MQTT_PASSWORD"
"""The environment variable with the password, which a command line would show to others."""
_USER = re.compile(r"^(\w*://)?.*@", re.DOTALL)
"""The user and the password in a URL, which no error repeats, also not one of a wrong URL."""
_PORTS = {"mqtt": 1883, "mqtts": 8883}
_END_S = 2.0
"""At the end, messages that wait are still published for this time (s)."""


@dataclass(frozen=True, slots=True)
class Broker:
    """The address of an MQTT broker, and where its messages go."""

    host: str
    port: int
    prefix: str
    """The first part of all topics."""
    user: str | None = None
    password: str | None = None
    tls: bool = False
    ca: str | None = None
    """The file with the CA of the broker's certificate; None for the CAs of the system."""

    @classmethod
    def parse(cls, text: str) -> Broker:
        """Read mqtt://[USER[:PASSWORD]@]HOST[:PORT][/PREFIX], or mqtts:// with ?ca=FILE.

        Raises UsageError for a text of another form.
        """
        shown = _USER.sub(r"\1", text)
        wanted = "mqtt://HOST[:PORT][/PREFIX], or mqtts:// for TLS"
        try:
            url = urlsplit(text)
            port = url.port
        except ValueError:
            raise UsageError(f"--mqtt {shown}: write {wanted}") from None
        if url.scheme not in _PORTS or not url.hostname or url.fragment:
            raise UsageError(f"--mqtt {shown}: write {wanted}")
        prefix = unquote(url.path.strip("/")) or "mbtool"
        if "#" in prefix or "+" in prefix:
            raise UsageError(f"--mqtt {shown}: a topic has no # and no +")
        query = parse_qs(url.query)
        if set(query) - {"ca"} or (query and url.scheme != "mqtts"):
            raise UsageError(f"--mqtt {shown}: only ?ca=FILE may follow, with mqtts://")
        return cls(
            url.hostname,
            port or _PORTS[url.scheme],
            prefix,
            None if url.username is None else unquote(url.username),
            None if url.password is None else unquote(url.password),
            url.scheme == "mqtts",
            query.get("ca", [None])[0],
        )


class MqttPublisher:
    """Publishes the latest message of each topic, while its `with` block runs."""

    def __init__(self, broker: Broker, on_remark: Callable[[str], None]) -> None:
        """Prepare to connect. `on_remark` gets a line when the broker is lost and when it is back,
        from another thread.

        Raises UsageError if paho-mqtt is not installed, LinkError for a CA file that is wrong.
        """
        if find_spec("paho") is None:
            raise missing_extra("--mqtt", "mqtt")
        from paho.mqtt.client import Client
        from paho.mqtt.enums import CallbackAPIVersion

        self._broker = broker
        self._on_remark = on_remark
        self._waiting: OrderedDict[str, tuple[bytes, bool]] = OrderedDict()
        self._retained: OrderedDict[str, bytes] = OrderedDict()
        """The latest message of each topic that the broker shall retain, the oldest first."""
        self._changed = threading.Condition()
        self._is_connected = threading.Event()
        self._is_ending = False
        self._confirmed: set[int] = set()
        """The ids of messages that the broker has confirmed since the last one was published."""
        self.dropped = 0
        """The number of messages that found no room, or that MQTT cannot carry."""
        self._was_told = False
        self._client = Client(CallbackAPIVersion.VERSION2)
        self._client.on_connect = self._connected
        self._client.on_publish = self._note_confirmed
        self._client.on_disconnect = self._disconnected
        self._client.on_connect_fail = lambda *_: self._report_lost("cannot be reached")
        self._client.reconnect_delay_set(1, 30)
        self._client.will_set(f"{broker.prefix}/status", b"offline", qos=1, retain=True)
        if broker.user is not None:
            password = broker.password or os.environ.get(PASSWORD)
            self._client.username_pw_set(broker.user, password)
        if broker.tls:
            try:
                context = ssl.create_default_context(cafile=broker.ca)
            except OSError as error:
                raise LinkError(f"{broker.ca}: cannot be used as a CA: {error}") from error
            self._client.tls_set_context(context)
        self._thread = threading.Thread(target=self._run, name="mqtt", daemon=True)

    def __enter__(self) -> MqttPublisher:
        self._client.connect_async(self._broker.host, self._broker.port)
        self._client.loop_start()
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        with self._changed:
            self._is_ending = True
            self._changed.notify()
        self._thread.join(_END_S)
        if self._is_connected.is_set():
            last = self._client.publish(
                f"{self._broker.prefix}/status", b"offline", qos=1, retain=True
            )
            with suppress(RuntimeError, ValueError):
                last.wait_for_publish(_END_S)
        self._client.disconnect()
        self._client.loop_stop()
        self._note_away()

    @property
    def prefix(self) -> str:
        """The first part of the topics."""
        return self._broker.prefix

    def publish(self, topic: str, payload: bytes, *, retain: bool = False) -> None:
        """Put a message for a topic, below the prefix, to be sent; never waits."""
        self.publish_at(f"{self._broker.prefix}/{topic}", payload, retain=retain)

    def publish_at(self, topic: str, payload: bytes, *, retain: bool = False) -> None:
        """Put a message for a whole topic to be sent; never waits."""
        with self._changed:
            if topic not in self._waiting and len(self._waiting) >= MAX_WAITING:
                self._waiting.popitem(last=False)
                self.dropped += 1
            self._waiting[topic] = payload, retain
            if retain:
                self._retained[topic] = payload
                self._retained.move_to_end(topic)
                if len(self._retained) > MAX_WAITING:
                    self._retained.popitem(last=False)
            self._changed.notify()

    def _run(self) -> None:
        while True:
            with self._changed:
                while not self._waiting and not self._is_ending:
                    self._changed.wait()
                if self._is_ending and not (self._waiting and self._is_connected.is_set()):
                    return
            if not self._is_connected.wait(0.5):
                continue
            with self._changed:
                if not self._waiting:
                    continue
                topic, (payload, retain) = self._waiting.popitem(last=False)
            self._send(topic, payload, retain=retain)

    def _send(self, topic: str, payload: bytes, *, retain: bool) -> None:
        """Publish a message, and wait until the broker has confirmed it, also after paho has
        connected again; at the end, only while the broker is there.
        """
        with self._changed:
            self._confirmed.clear()
        try:
            sent = self._client.publish(topic, payload, qos=1, retain=retain).mid
        except ValueError:  # The topic or the payload is too long.
            self.dropped += 1
            return
        with self._changed:
            while sent not in self._confirmed and (
                self._is_connected.is_set() or not self._is_ending
            ):
                self._changed.wait()

    def _note_confirmed(self, _: object, __: object, message: int, *___: object) -> None:
        with self._changed:
            self._confirmed.add(message)
            self._changed.notify()

    def _connected(self, client: Any, _: object, __: object, reason: Any, *___: object) -> None:
        if reason.is_failure:
            self._report_lost(f"refuses the connection: {reason}")
            return
        client.publish(f"{self._broker.prefix}/status", b"online", qos=1, retain=True)
        if self._was_told:
            self._on_remark(f"mqtt {self._place}: connected")
        self._was_told = False
        with self._changed:
            for topic, payload in self._retained.items():
                if len(self._waiting) < MAX_WAITING:
                    self._waiting.setdefault(topic, (payload, True))
            self._changed.notify()
        self._is_connected.set()

    def _disconnected(self, *_: object) -> None:
        self._note_away()
        if not self._is_ending:
            self._report_lost("the connection is lost")

    def _note_away(self) -> None:
        with self._changed:
            self._is_connected.clear()
            self._changed.notify()

    def _report_lost(self, why: str) -> None:
        """Tell once that the broker is away, until it is back."""
        if not self._was_told:
            self._was_told = True
            self._on_remark(f"mqtt {self._place}: {why}; recording goes on, and values wait")

    @property
    def _place(self) -> str:
        return f"{self._broker.host}:{self._broker.port}"
