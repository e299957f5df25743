"""Tells the user if a slave's responses name a model whose profile is not in use for the slave."""

# The response to function 42H of an FA3 module contains its model code. mbtool does not choose the
# profile by this code, since the meaning of a register would then change within a capture. It tells
# the user instead: by a hint, or by a warning if the profile of another model is in use, whose
# registers have the same addresses but other meanings.
#
# A SunSpec device lists its SunSpec models in registers. A hint tells the user which they are,
# unless the slave has a profile.
#
# Memory: one hint for each slave, at most MAX_HINTS. Built-in profiles are loaded when the first
# response to a vendor's own function is seen.

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from mbtool.core import WireEvent
from mbtool.devices import NamedTransaction, Profile, Who, builtin_profiles, load_profile
from mbtool.devices.identity import answer_word
from mbtool.devices.sunspec_map import MARK, SunSpecMap
from mbtool.modbus import FUNCTIONS
from mbtool.workflows.shared.sunspec_devices import Slave, SunSpecDevices, described

if TYPE_CHECKING:
    from mbtool.decode.decoder import Record

MAX_HINTS = 64


class ModelHints:
    """Collects hints for the user about the models of slaves, from the transactions of one reading
    of the files.
    """

    def __init__(self, profile_for: Callable[[NamedTransaction], Profile | None]) -> None:
        self._profile_for = profile_for
        self._models: dict[tuple[int, int], Profile] | None = None
        self._hints: dict[tuple[str, int], str] = {}
        self._sunspec = SunSpecDevices()
        self._named: set[Slave] = set()
        """The SunSpec devices that already have a profile, so that the user needs no hint."""

    def note(self, record: Record) -> str | None:
        """Look at the next transaction or event; return a hint for the user if this one is the
        first to tell a slave's model, else None.
        """
        if isinstance(record, WireEvent):
            return None
        if record.function in FUNCTIONS:
            values = record.response_values  # Nearly all records end here: no call, for speed.
            if values and (self._sunspec.maps or MARK[0] in values):
                return self._note_sunspec(record)
            return None
        word = answer_word(record)
        where = record.destination or record.link
        if word is None or (where, record.unit) in self._hints or len(self._hints) >= MAX_HINTS:
            return None
        model = self._model(record.function, word)
        if model is None or record.transport.over_tcp not in model.transports:
            return None
        hint = _hint(record, model, self._profile_for(record))
        if hint is not None:
            self._hints[where, record.unit] = hint
        return hint

    @property
    def remarks(self) -> list[str]:
        """All hints: one line for each slave whose model was found, unless the profile in use is
        the one for that model.
        """
        maps = self._sunspec.maps
        sunspec = [_sunspec_hint(*each) for each in maps.items() if each[0] not in self._named]
        return [*self._hints.values(), *filter(None, sunspec)]

    def _note_sunspec(self, record: NamedTransaction) -> str | None:
        maps = self._sunspec.maps
        before = len(maps)
        slave = self._sunspec.note(record)
        if len(maps) > before and self._profile_for(record) is not None:
            self._named.add(next(reversed(maps)))
        if slave is None or slave in self._named:
            return None
        return _sunspec_hint(slave, maps[slave])

    def _model(self, function: int, word: int) -> Profile | None:
        if self._models is None:
            from mbtool.devices.profile_match import models_of

            self._models = models_of(map(load_profile, builtin_profiles()))
        return self._models.get((function, word))


def _sunspec_hint(slave: Slave, found: SunSpecMap) -> str | None:
    link, destination, unit = slave
    if not found.models:
        return None
    return (
        f"unit {unit} at {destination or link} is {described(found)}; mbtool devices draft with "
        "--sunspec makes its profile"
    )


def _hint(record: NamedTransaction, model: Profile, named_by: Profile | None) -> str | None:
    who = Who.of_slave(record.destination, record.unit).at_any_port
    said = f"unit {record.unit} at {record.destination or record.link} is {model.title}, "
    said += f"as its answer to {record.function:02X}H says"
    if named_by is None:
        return f"{said}; name it with --device {who}={model.name}"
    from mbtool.devices.profile_match import model_function

    is_other = named_by.model_code is not None and named_by.model_code != model.model_code
    if is_other and model_function(named_by) == record.function:
        return f"{said}, but it is named as {named_by.name}: give --device {who}={model.name}"
    return None
