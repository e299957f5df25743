"""Converts a device profile to a format of the user's choice, for mbtool or other programs."""

from __future__ import annotations

from enum import StrEnum

import msgspec

from mbtool.devices import Profile, dump_profile, profile_to_json
from mbtool.devices.exporting.exported_points import ExportedMap
from mbtool.devices.exporting.home_assistant import export_home_assistant
from mbtool.devices.exporting.register_list import export_register_list
from mbtool.devices.exporting.sunspec_model import export_sunspec
from mbtool.devices.exporting.telegraf import export_telegraf


class ExportForm(StrEnum):
    """A format in which a device profile can be exported; TELEGRAF is one for that program."""

    TOML = "toml"
    JSON = "json"
    CSV = "csv"
    TELEGRAF = "telegraf"
    HOME_ASSISTANT = "home-assistant"
    SUNSPEC = "sunspec"

    @property
    def suffixes(self) -> tuple[str, ...]:
        """The suffixes that the name of a file in this format may have."""
        match self:
            case ExportForm.TOML:
                return (".toml",)
            case ExportForm.CSV:
                return (".csv",)
            case ExportForm.TELEGRAF:
                return (".conf", ".toml")
            case ExportForm.HOME_ASSISTANT:
                return (".yaml", ".yml")
            case ExportForm.JSON | ExportForm.SUNSPEC:
                return (".json",)


def exported(profile: Profile, form: ExportForm, unit: int = 1) -> ExportedMap:
    """Return the profile in the format `form`.

    `unit` is the unit id that a polling program (Telegraf, Home Assistant) is told to poll. Raises
    UsageError if the format is SUNSPEC and the profile is no SunSpec model.
    """
    match form:
        case ExportForm.TOML:
            return ExportedMap(dump_profile(profile))
        case ExportForm.JSON:
            text = msgspec.json.format(profile_to_json(profile), indent=2).decode()
            return ExportedMap(f"{text}\n")
        case ExportForm.CSV:
            return export_register_list(profile)
        case ExportForm.TELEGRAF:
            return export_telegraf(profile, unit)
        case ExportForm.HOME_ASSISTANT:
            return export_home_assistant(profile, unit)
        case ExportForm.SUNSPEC:
            return export_sunspec(profile)
