"""The errors that this program raises, one class for each cause. Bytes from a wire never raise."""

# Examples:
#
#   UsageError     `--on rtu:/dev/ttyUSB0@fast`, `--device 5=no-such-profile`, `--where "unit ="`
#   ProfileError   a profile whose area ends before it begins (file, key, what would be right)
#   InputError     a capture that is absent, unreadable or of another kind
#   CutError       a capture that ends in the middle of a record; raised after the last whole record
#   DamageError    a log or capture in which a byte has changed; raised after all whole records
#   EmptyError     a text without any Modbus frame
#   LinkError      a port that is absent, busy or forbidden; an address in use
#   OutputError    a disk that is full while a log is written
#
# The text of an error is one line. It names the file, port or option that is at fault, and says
# what would be right.

from __future__ import annotations

import errno
import os
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pathlib import PurePath


class MbtoolError(Exception):
    """Any error that this program raises on purpose; its text is one line for the user."""


class UsageError(MbtoolError):
    """An option, a link, a query or a profile is wrong."""


class ProfileError(UsageError):
    """A key in a device profile has a value that this key cannot have."""

    def __init__(self, file: str, key: str, problem: str) -> None:
        super().__init__(f"{file}: {key}: {problem}")
        self.file = file
        self.key = key
        self.problem = problem


class InputError(MbtoolError):
    """A file that is to be read is absent, damaged or of another kind, or cannot be read."""


class CutError(InputError):
    """A file ends in the middle of a record. Raised after all earlier records were returned."""


class DamageError(InputError):
    """A file is damaged. Raised after all records that can be read were returned."""


class EmptyError(InputError):
    """A file was read to its end, and holds nothing of Modbus. Raised at its end."""


class LinkError(MbtoolError):
    """A link could not be opened, or was lost."""


class OutputError(MbtoolError):
    """An output could not be written, as with a full disk or a closed standard output."""


def reason_unwritten(path: str | PurePath, error: OSError | ValueError) -> str:
    """Return why a file cannot be written: that its folder is missing, or the text of the error."""
    folder = os.path.dirname(path)
    if getattr(error, "errno", None) == errno.ENOENT and folder and not os.path.isdir(folder):
        return f"there is no folder {folder}"
    return reason_of(error)


def reason_of(error: OSError | ValueError) -> str:
    """Return the operating system's text for an error, without its number and file name.

    If the error has no such text, returns str(error).
    """
    return getattr(error, "strerror", None) or str(error)
