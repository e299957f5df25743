"""Makes a profile from a register list: a vendor's table of registers, saved as CSV."""

# The import guesses what neither the list nor the user states. A remark reports each guess; the
# remarks are also in a comment at the top of the profile. All unreadable rows are reported
# together. Then no profile is made, unless the user allows that such rows are left out.
#
# Limits: a file of at most MAX_BYTES bytes and MAX_ROWS rows.

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import PurePath
from typing import TYPE_CHECKING

from mbtool.core.errors import UsageError
from mbtool.devices.dumping import dump_profile
from mbtool.devices.importing.areas import MAX_HOLE, make_areas
from mbtool.devices.importing.body import BodyReader, tell_columns
from mbtool.devices.importing.columns import find_sheet
from mbtool.devices.importing.locating import locate_rows
from mbtool.devices.importing.options import ImportOptions, ImportReport
from mbtool.devices.importing.points import make_points
from mbtool.devices.loading import MAX_FILE_BYTES
from mbtool.devices.model import Profile
from mbtool.devices.profile_template import name_for
from mbtool.devices.validation import validate
from mbtool.modbus.adu import Transport

if TYPE_CHECKING:
    from collections.abc import Sequence

MAX_BYTES = 4 << 20
MAX_ROWS = 20_000


class BadRowsError(UsageError):
    """Raised if rows of a register list cannot be read; `lines` has the messages about them."""

    def __init__(self, file: str, report: ImportReport) -> None:
        count = len(report.bad_rows)
        rows = f"{count} rows are" if count > 1 else "1 row is"
        super().__init__(
            f"{file}: {rows} wrong, so no profile was made (--skip-bad leaves them out)"
        )
        self.lines = [f"{file}: {line}" for line in report.problem_lines]


@dataclass(frozen=True, slots=True)
class ImportedList:
    """A profile made from a register list, or from a file of another program."""

    profile: Profile
    text: str
    """The profile as the text of a TOML file."""
    remarks: tuple[str, ...]
    """Sentences for the user about each guess, and about everything that was left out."""


def import_register_list(
    data: bytes, file: str, options: ImportOptions | None = None, name: str | None = None
) -> ImportedList:
    """Make a profile from a register list. `data` is the file's content, `file` its name.

    If `name` is None, the profile is named after the file. Raises BadRowsError if rows cannot be
    read and the options do not skip them, and UsageError if the file is no register list.
    """
    options, report = options or ImportOptions(), ImportReport()
    sheet = find_sheet(_decode(data, file, report), file, options.columns)
    if len(sheet.rows) > MAX_ROWS:
        raise UsageError(f"{file}: more than {MAX_ROWS} rows are no register list")
    tell_columns(sheet, report)
    rows = BodyReader(sheet, options, report).read()
    located = locate_rows(rows, sheet.addresses, options, report)
    made = make_points(located, options.word_order, report)
    if report.bad_rows and not options.skip_bad:
        raise BadRowsError(file, report)
    for line in report.problem_lines:
        report.tell(f"left out: {line}")
    if not made:
        heading = sheet.addresses.heading
        raise UsageError(f'{file}: no row below its headings has an address in "{heading}"')
    areas, points, functions = make_areas(made)
    profile = Profile(
        name=name or name_for(file),
        title=PurePath(file).stem or file,
        vendor="unknown",
        transports=[Transport.RTU, Transport.TCP],
        source=f"register list {PurePath(file).name}",
        areas=areas,
        functions=functions,
        points=points,
    )
    validate(profile, file)
    text = _text(profile, report.remarks)
    if len(text.encode()) > MAX_FILE_BYTES:
        raise UsageError(
            f"{file}: its profile would have more than {MAX_FILE_BYTES} bytes; "
            "import a part of the list"
        )
    return ImportedList(profile, text, tuple(report.remarks))


def _decode(data: bytes, file: str, report: ImportReport) -> str:
    if len(data) > MAX_BYTES:
        raise UsageError(f"{file}: more than {MAX_BYTES} bytes are no register list")
    if data.startswith((b"PK\x03\x04", b"\xd0\xcf\x11\xe0")):
        raise UsageError(f"{file}: a spreadsheet; export it as CSV and import that")
    is_wide = data.startswith((b"\xff\xfe", b"\xfe\xff"))
    try:
        return _plain_text(data.decode("utf-16" if is_wide else "utf-8-sig"))
    except UnicodeDecodeError:
        report.tell("not UTF-8, so read as Latin-1: check \u00b0, \u00b5 and umlauts")
        return _plain_text(data.decode("cp1252", errors="replace"))


_CONTROL = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f\u2028\u2029\ud800-\udfff]")


def _plain_text(text: str) -> str:
    """Return a text with line feeds as line ends, and without other control characters.

    No text of a profile may have control characters.
    """
    text = text.replace("\r\n", "\n").replace("\r", "\n")
    return text if text.isprintable() else _CONTROL.sub("", text)


def _text(profile: Profile, remarks: Sequence[str]) -> str:
    """The profile as the text of a TOML file, with the remarks in a comment at the top."""
    return dump_profile(
        profile,
        {
            "": [
                f"Made by mbtool devices import from the {profile.source}.",
                "Check what it took for granted:",
                *(f"- {remark}" for remark in remarks),
                f"- an area goes on over up to {MAX_HOLE - 1} addresses that the list leaves out",
                "- limits of quantities, exceptions and timing are the standard's",
                "The keys of a profile are explained in docs/devices.md of mbtool.",
            ]
        },
    )
