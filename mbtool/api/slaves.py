"""Slaves for Python programs and tests: a device by its profile, or the slaves of a recording."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from enum import StrEnum
from fractions import Fraction
from os import fspath
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from mbtool.api.arguments import assignments_of, condition_of, profile_of
from mbtool.api.observed_shell import ObservedShell, monitor_of
from mbtool.core import UsageError
from mbtool.devices.values import PointInstance
from mbtool.ports.tcp_listener import AllowedPeers
from mbtool.replay import MatchStrategy, OnEnd, OnMiss, TimeRange
from mbtool.slave.device.image_file import load_image
from mbtool.workflows.replay_slave import SlaveOptions, SlaveRun
from mbtool.workflows.shared.reading import ReadingOptions
from mbtool.workflows.slave import Station, device_slave

if TYPE_CHECKING:
    from mbtool.api.arguments import AnyPath, Devices, ProfileName
    from mbtool.slave.device.value_targets import ValueTarget

_Choice = TypeVar("_Choice", bound=StrEnum)

LOOPBACK = "tcp:127.0.0.1:0"
"""The default link of a slave: this machine, at a TCP port that the system chooses."""

Values = Mapping[str, object]
"""Values by reference or name, as in a file for `--image`: {"HR400001": 4660, "C1": 1}."""


class RawValues:
    """Gives the registers or bits that a reference or a name stands for, as a list."""

    def __init__(self, read: Callable[[str], list[int]]) -> None:
        self._read = read

    def __getitem__(self, what: str) -> list[int]:
        """Return the contents of the registers. Raises UsageError for an unknown reference."""
        return self._read(what)


class Slave(ObservedShell):
    """A device that answers as its manual says, while its `with` block runs."""

    def __init__(
        self,
        profile: ProfileName,
        on: str = LOOPBACK,
        *,
        unit: int = 1,
        image: AnyPath | Values | None = None,
        others: Mapping[int, ProfileName] | None = None,
        faults: AnyPath | Sequence[Mapping[str, object]] | None = None,
        allow: Sequence[str] = (),
        strict_timing: bool = False,
    ) -> None:
        """Prepare a device of a profile: a built-in name, or the path of a TOML file.

        `on` is the link on which it answers: "tcp:HOST:PORT", "rtu+tcp:HOST:PORT",
        "rtu:PORT@19200-8E1", "ascii:PORT@9600-7E1"; without it, a free TCP port of this machine.
        `image` has its start values: a TOML file, or {"HR400001": 4660, "HR400010": [1, 2, 3]}.
        `others` are further devices on the same link: their profiles by unit. `faults` is a TOML
        file (docs/faults.md) or a list of its tables: [{"kind": "no-answer", "times": 2}]. `allow`
        names networks whose masters may connect, beside those of this machine. With
        `strict_timing`, an RTU request whose silences (t1.5, t3.5) are wrong gets no response.

        Raises UsageError for an argument that is wrong, InputError for a file that cannot be read.
        """
        own = profile_of(profile)
        beside = {number: profile_of(name) for number, name in (others or {}).items()}
        if unit in beside:
            raise UsageError(f"others: unit {unit} is the first device; choose another unit")
        super().__init__(on, [own, *beside.values()])
        self._profile = own
        self._unit = unit
        self._monitor = monitor_of(own, self._spec, beside)
        self._shell = device_slave(
            own,
            self._spec,
            unit,
            _source(image),
            others={number: Station(one) for number, one in beside.items()},
            allowed=AllowedPeers.parse(allow),
            monitor=self._monitor,
            strict_timing=strict_timing,
            wrapped=self._wrapped,
        )
        self._targets = self._value_targets[0]
        self._behaviour = self._monitor.behaviours[unit]
        if faults is not None:
            self._add_faults(faults)

    def __getitem__(self, what: str) -> float | str | list[int]:
        """Return the value of a register or bit, or that of a named point in its unit and type.

        `what` is a reference, which gives the content of a register (a list if its point has
        several), or the name of a point: 21.5, a text for a string. Raises UsageError for an
        unknown reference.
        """
        target = self._targets.find(what)
        values = self._registers(target)
        if target.is_named and not target.is_reference and target.point is not None:
            shown = PointInstance(target.point, target.address, what).value(values)
            return shown.text if shown.value is None else shown.value
        return values[0] if len(values) == 1 else values

    @property
    def raw(self) -> RawValues:
        """The registers themselves: `slave.raw["Setpoint"] == [215]`, also those of a reference."""
        return RawValues(lambda what: self._registers(self._targets.find(what)))

    def _registers(self, target: ValueTarget) -> list[int]:
        image = self._behaviour.image
        with self._lock:
            if target.point is not None and target.point.block is not None:
                span = range(target.address, target.address + target.words)
                return image.blocks.get(target.table, span) or []
            return image.get(target.table, target.address, target.words)

    def __setitem__(self, what: str, value: object) -> None:
        """Set a register, bit or point; a list sets consecutive registers, as in `image`.

        Access rights are ignored, so inputs can be set. Raises UsageError for an unknown reference
        or a value that does not fit.
        """
        if isinstance(value, Mapping):
            raise UsageError(f"{what}: a value that changes over time is for `image` only")
        with self._lock:
            load_image({what: value}, self._profile, self._behaviour.image)
            if self._switch is not None:
                self._switch.before_next(self._behaviour.inputs_set)

    @property
    def outputs(self) -> dict[str, str]:
        """The state of the device's outputs as text, by their names; empty if it has none."""
        return {one.name: one.text for one in self._behaviour.outputs()}

    @property
    def _lock(self) -> Any:
        assert self._switch is not None
        return self._switch.lock


class Replay(ObservedShell):
    """The slaves of a recording, which answer as they did, while its `with` block runs."""

    def __init__(
        self,
        path: AnyPath,
        on: str = LOOPBACK,
        *,
        match: str = "auto",
        on_miss: str = "image",
        on_end: str = "last",
        latency: str = "recorded",
        speed: float | None = 1,
        start: float = 0,
        end: float | None = None,
        where: str | None = None,
        devices: Devices | None = None,
        ports: Sequence[int] = (),
        rtu_ports: Sequence[int] = (),
        any_port: bool = False,
        faults: AnyPath | Sequence[Mapping[str, object]] | None = None,
        allow: Sequence[str] = (),
    ) -> None:
        """Prepare to answer from a capture or a log; docs/replay.md describes the options.

        `on` is the link on which to answer, as for `Slave`. `match` says how a response is found:
        "auto", "sequence", "key", "time", "image"; `on_miss` what a request gets that was never
        recorded: "image", "exception", "silent"; `on_end` what a request gets after its last
        recorded response: "last", "loop", "image", "silent". `latency` is "recorded", "none",
        "sampled" or a time such as "5ms"; `speed` 2 plays twice as fast, None without any delay.
        `start` and `end` choose a part of the recording, in seconds from its first request; `where`
        chooses transactions: 'link == "10.0.0.9"'. `devices`, `ports`, `rtu_ports` and `any_port`
        are as for `open`, `faults` and `allow` as for `Slave`.

        Raises InputError if the recording cannot be read or has no request, UsageError for an
        argument that is wrong.
        """
        assignments = assignments_of(devices)
        options = SlaveOptions(
            reading=ReadingOptions(
                assignments=assignments, ports=ports, rtu_ports=rtu_ports, any_port=any_port
            ),
            wanted=condition_of(where),
            rate=None if speed is None else _rate(speed),
            match=_choice(MatchStrategy, "match", match),
            on_miss=_choice(OnMiss, "on_miss", on_miss),
            on_end=_choice(OnEnd, "on_end", on_end),
            latency=latency,
            window=_window(start, end),
        )
        self.remarks: list[str] = []
        """Lines about the recording, such as that it is cut."""
        run = SlaveRun(fspath(path), options, self.remarks.append)
        profiles = run.profile_of
        super().__init__(on, list({one.name: one for one in profiles.values()}.values()))
        self._monitor = monitor_of(None, self._spec, profiles)
        played = run.create_slave(
            self._spec,
            allowed=AllowedPeers.parse(allow),
            on_exchange=self._monitor.take,
            wrapped=self._wrapped,
        )
        self._shell = played.shell
        self.units = sorted(run.recording.units)
        """The units (slave addresses) that answer."""
        if faults is not None:
            self._add_faults(faults)


def _source(image: AnyPath | Values | None) -> Path | Values | None:
    return image if image is None or isinstance(image, Mapping) else Path(fspath(image))


def _rate(speed: float) -> Fraction:
    if not 0 < speed < 1e9:
        raise UsageError(f"speed {speed!r}: write a number above 0, or None for no delay")
    return Fraction(speed)


def _window(start: float, end: float | None) -> TimeRange:
    if start < 0 or (end is not None and end <= start):
        raise UsageError(f"start {start}, end {end}: write seconds, the end after the start")
    return TimeRange(round(start * 1e9), None if end is None else round(end * 1e9))


def _choice(choices: type[_Choice], name: str, text: str) -> _Choice:
    try:
        return choices(text)
    except ValueError:
        raise UsageError(f"{name} {text!r}: write one of {', '.join(choices)}") from None
