"""Reads a TOML file with the values that a slave starts with and those that change over time."""

# A key names a register, a bit or a point (value_targets.py). The value is a number, a list of
# numbers for consecutive addresses, or a TOML table for a value that changes:
#
#     HR400001 = 4660
#     HR400010 = [1, 2, -3]      # negative numbers are 16-bit two's complement
#     C1 = 1
#     "CH1 digital value" = { ramp = [0, 16000], seconds = 10 }
#     HR400020 = { sine = [0, 100], seconds = 60 }
#     HR400023 = { steps = [0, 50, 100], seconds = 5 }
#     HR400021 = { walk = [0, 100], step = 2, seconds = 0.5, seed = 7 }
#     HR400022 = { from = "site.mcap", what = "HR400001", unit = 3, speed = 2, loop = false }
#
# Lines are applied in their order: where ranges overlap, the later line counts. A changing value
# overrides all constant ones. Access rights of the profile are ignored, so inputs can be set too.
#
# Limits: a file of at most 4 MiB, enough for a value for every address of all four tables.

from __future__ import annotations

import difflib
import math
import reprlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from random import Random
from typing import TYPE_CHECKING, Any, NoReturn, Protocol

from mbtool.core import UsageError
from mbtool.devices.loading import read_toml
from mbtool.modbus.tables import Table
from mbtool.slave.device.value_targets import ValueTarget, ValueTargets

if TYPE_CHECKING:
    from mbtool.devices import Profile
    from mbtool.slave.device.image import RegisterImage

# Values that change over time, each computed from the time since the slave's first request.
#
# Times are integer nanoseconds from 0 on.
#
#     ramp    rises (or falls) evenly from the first value to the last, then begins again
#     sine    swings between the lowest and the highest value and begins in the middle, rising
#     steps   shows one value after the other, each for the same time, then begins again
#     walk    begins in the middle and takes a random step at regular times; the size of a step is
#             normally distributed, and the walk turns back at the lowest and the highest value
#
# Ramp, sine and steps depend on the time alone. A walk is computed step by step from its seed, so
# the same seed gives the same walk. If more than MAX_STEPS steps are due since the last request,
# only MAX_STEPS of them are computed, so that a response is delayed by at most about 50 ms.

MAX_STEPS = 100_000


class Signal(Protocol):
    """A value that changes over time."""

    @property
    def lowest(self) -> float: ...

    @property
    def highest(self) -> float: ...

    def at(self, moment_ns: int) -> float:
        """Return the value at `moment_ns`, in ns since the first request.

        No call may have an earlier moment than the call before it.
        """
        ...


@dataclass(frozen=True, slots=True)
class Ramp:
    """A sawtooth from `first` to `last`; it falls if `last` is the lower one."""

    first: float
    last: float
    period_ns: int

    @property
    def lowest(self) -> float:
        return min(self.first, self.last)

    @property
    def highest(self) -> float:
        return max(self.first, self.last)

    def at(self, moment_ns: int) -> float:
        share = moment_ns % self.period_ns / self.period_ns
        return self.first + (self.last - self.first) * share


@dataclass(frozen=True, slots=True)
class Sine:
    """A sine wave between `lowest` and `highest`; one swing takes `period_ns`."""

    lowest: float
    highest: float
    period_ns: int

    def at(self, moment_ns: int) -> float:
        swing = math.sin(2 * math.pi * (moment_ns % self.period_ns) / self.period_ns)
        value = (self.lowest + self.highest) / 2 + (self.highest - self.lowest) / 2 * swing
        return min(max(value, self.lowest), self.highest)


@dataclass(frozen=True, slots=True)
class Steps:
    """A signal that has each of several values for `every_ns`, in turn."""

    values: Sequence[float]
    every_ns: int

    @property
    def lowest(self) -> float:
        return min(self.values)

    @property
    def highest(self) -> float:
        return max(self.values)

    def at(self, moment_ns: int) -> float:
        return self.values[moment_ns // self.every_ns % len(self.values)]


@dataclass(slots=True)
class Walk:
    """A random walk between two values."""

    lowest: float
    highest: float
    step: float
    """Standard deviation of one step, in the unit of the value."""
    every_ns: int
    seed: str
    _random: Random = field(init=False, repr=False)
    _value: float = field(init=False, repr=False)
    _number: int = field(init=False, default=0, repr=False)
    """The number of the step that `_value` belongs to: the moment of the last call of `at`, divided
    by `every_ns`. Steps that were left out because of MAX_STEPS count."""

    def __post_init__(self) -> None:
        self._random = Random(self.seed)
        self._value = (self.lowest + self.highest) / 2

    def at(self, moment_ns: int) -> float:
        number = moment_ns // self.every_ns
        for _ in range(min(number - self._number, MAX_STEPS)):
            self._value = self._turned_back(self._value + self._random.gauss(0, self.step))
        self._number = max(number, self._number)
        return self._value

    def _turned_back(self, value: float) -> float:
        """Return the value, brought back into the range of the walk if it is outside.

        It lies as far inside the limit that it has crossed as it was outside.
        """
        width = self.highest - self.lowest
        if not width:
            return self.lowest
        distance = (value - self.lowest) % (2 * width)
        return min(
            max(self.lowest + min(distance, 2 * width - distance), self.lowest), self.highest
        )


MAX_FILE_BYTES = 4 << 20
MAX_SECONDS = 10_000_000

_FORMS = {
    "ramp": ("seconds",),
    "sine": ("seconds",),
    "steps": ("seconds",),
    "walk": ("step", "seconds", "seed"),
    "from": ("what", "unit", "link", "speed", "loop"),
}
"""The kinds of changing value, each with the optional keys of its TOML table."""
_GREATEST = 1e300
"""The greatest number allowed. Twice the difference of two such numbers is still a finite float."""
_STEPS = 20
"""The default step of a walk is the difference of its lowest and highest value, divided by this."""

Course = Callable[[int], list[int]]
"""The course of a value: a function that takes a time, in ns since the first request, and returns
the contents of the registers or the bit at that time."""


@dataclass(frozen=True, slots=True)
class Driven:
    """A register, bit or point whose value changes over time."""

    target: ValueTarget
    course: Course


@dataclass(frozen=True, slots=True)
class FromCapture:
    """Names a recorded value to repeat: which value, from which capture, and how fast."""

    path: Path
    table: Table
    address: int
    words: int
    unit: int | None
    """The unit that the value belongs to; None for the only unit in the capture."""
    link: str | None
    """The link of the unit in the capture; None if the unit is on only one link there."""
    speed: float
    loop: bool


Recall = Callable[[FromCapture], Course]
"""Reads from a capture how a value changed over time, and returns it as a Course. Raises UsageError
if the capture does not have the value, InputError if it cannot be read."""


def load_image(
    source: Path | Mapping[str, Any],
    profile: Profile,
    image: RegisterImage,
    only: Sequence[tuple[Table, range]] | None = None,
    *,
    recall: Recall | None = None,
) -> list[Driven]:
    """Write the constant values of a file into an image, and return the values that change.

    `source` is the path of the file, or a mapping with its keys and values. Captures that it names
    are looked for beside the file, or in the current directory. `only` is None for start values.
    For the file that keeps a device's state it lists the addresses that may be set, each to the
    content of a register. `recall` reads values from captures; with None the file may not name any.
    Raises InputError for a file that cannot be read, UsageError for one that is no TOML or has a
    wrong key or value; the image then holds the values of the lines before the wrong one.
    """
    hint = "write lines such as HR400001 = 4660"
    targets = ValueTargets(profile)
    driven: list[Driven] = []
    if isinstance(source, Path):
        path, values_of = source, read_toml(source, MAX_FILE_BYTES, "register image", hint)
    else:
        path, values_of = Path("image"), dict(source)
    for key, value in values_of.items():
        try:
            target = targets.find(key)
        except UsageError as error:
            raise UsageError(f"{path}: {error}") from error
        try:
            if isinstance(value, dict) and only is None:
                movement = _Movement(path, key, target, targets, value)
                _demand_area(profile, target, target.words)
                driven.append(Driven(target, movement.course(recall)))
                continue
            values = target.all_registers(value, stored=only is not None)
            _demand_area(profile, target, len(values))
            span = range(target.address, target.address + len(values))
            if only is not None and not _is_among(target.table, span, only):
                raise UsageError(
                    f"{profile.name} does not keep this over a restart; "
                    f"is this a file of start values, for --image?"
                )
            target.put(image, values)
        except (UsageError, ValueError, OverflowError) as error:
            raise UsageError(f"{path}: {key}: {error}") from error
    return driven


def _demand_area(profile: Profile, target: ValueTarget, count: int) -> None:
    if profile.area(target.table, target.address, count) is None and (
        target.point is None or target.point.block is None
    ):
        area = profile.area(target.table, target.address)
        if area is None:
            raise UsageError(f"{profile.name} has no such address")
        values = "1 value does" if count == 1 else f"{count} values do"
        raise UsageError(f"{values} not fit its area, which ends at {area.reference(area.last)}")


def _is_among(table: Table, span: range, parts: Sequence[tuple[Table, range]]) -> bool:
    return any(
        table is each and span.start in part and span.stop <= part.stop for each, part in parts
    )


class _Movement:
    """Reads the TOML table of one changing value, such as `{ ramp = [0, 9] }`."""

    def __init__(
        self,
        path: Path,
        key: str,
        target: ValueTarget,
        targets: ValueTargets,
        table: dict[str, Any],
    ) -> None:
        self._path = path
        self._key = key
        self._target = target
        self._targets = targets
        self._table = table
        forms = [form for form in _FORMS if form in table]
        if len(forms) != 1:
            known = ", ".join(_FORMS)
            raise UsageError(f"{reprlib.repr(table)}: write a number, or one of {known} in braces")
        self._form = forms[0]
        for each in table:
            if each != self._form and each not in _FORMS[self._form]:
                near = difflib.get_close_matches(each, _FORMS[self._form], n=1)
                known = f"did you mean {near[0]}?" if near else ", ".join(_FORMS[self._form])
                self._refuse(each, f"does not go with {self._form}; {known}")

    def course(self, recall: Recall | None) -> Course:
        if self._form == "from":
            wanted = self._from_capture()
            if recall is None:
                self._refuse("from", "no capture can be read here")
            return recall(wanted)
        signal = self._signal()
        for end in (signal.lowest, signal.highest):
            self._target.nearest(end)
        target = self._target
        return lambda moment_ns: target.nearest(signal.at(moment_ns))

    def _signal(self) -> Signal:
        seconds_ns = round(self._number("seconds", None, 0.001, MAX_SECONDS) * 1e9)
        if self._form == "steps":
            return Steps(self._listed(), seconds_ns)
        first, last = self._pair()
        if self._form == "ramp":
            return Ramp(first, last, seconds_ns)
        lowest, highest = min(first, last), max(first, last)
        if self._form == "sine":
            return Sine(lowest, highest, seconds_ns)
        step = self._number("step", (highest - lowest) / _STEPS, 0, 1e12)
        seed = self._number("seed", 0, -(1 << 63), 1 << 63)
        return Walk(lowest, highest, step, seconds_ns, f"{seed}/{self._key.casefold()}")

    def _from_capture(self) -> FromCapture:
        source = self._target
        what = self._text("what")
        if what is not None:
            source = self._targets.find(what)
            if source.table.is_bits != self._target.table.is_bits:
                self._refuse("what", f"{what!r}: a bit and a register cannot stand for each other")
        name = self._text("from") or ""
        loop = self._table.get("loop", True)
        if not isinstance(loop, bool):
            self._refuse("loop", f"{reprlib.repr(loop)}: write true or false")
        unit = self._table.get("unit")
        if unit is not None and (not isinstance(unit, int) or not 0 <= unit <= 0xFF):
            self._refuse("unit", f"{reprlib.repr(unit)}: write a number from 0 to 255")
        return FromCapture(
            self._path.parent / name,
            source.table,
            source.address,
            self._target.words,
            unit,
            self._text("link"),
            self._number("speed", 1, 0.001, 1_000_000),
            loop,
        )

    def _text(self, key: str) -> str | None:
        value = self._table.get(key)
        if value is not None and (not isinstance(value, str) or not value):
            self._refuse(key, f"{reprlib.repr(value)}: write a text in quotes")
        return value

    def _pair(self) -> tuple[float, float]:
        pair = self._table[self._form]
        if not isinstance(pair, list) or len(pair) != 2 or not all(map(_is_number, pair)):
            self._refuse(self._form, f"{reprlib.repr(pair)}: write two numbers, such as [0, 100]")
        return float(pair[0]), float(pair[1])

    def _listed(self) -> list[float]:
        values = self._table[self._form]
        if not isinstance(values, list) or not values or not all(map(_is_number, values)):
            self._refuse(self._form, f"{reprlib.repr(values)}: write numbers, such as [0, 50, 100]")
        return [float(value) for value in values]

    def _number(self, key: str, default: float | None, least: float, greatest: float) -> float:
        if key not in self._table and default is not None:
            return default
        value = self._table.get(key)
        if value is None:
            self._refuse(key, f"is missing; {self._form} needs it")
        if not _is_number(value) or not least <= value <= greatest:
            self._refuse(key, f"{reprlib.repr(value)}: write a number from {least} to {greatest}")
        return float(value) if key != "seed" else value

    def _refuse(self, key: str, problem: str) -> NoReturn:
        raise UsageError(f"{key}: {problem}")


def _is_number(value: object) -> bool:
    if not isinstance(value, int | float) or isinstance(value, bool):
        return False
    return -_GREATEST <= value <= _GREATEST
