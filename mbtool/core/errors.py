"""Errors by whose they are. Bytes on a wire never raise; these are for people and machines."""

# Example scenarios:
#
#   UsageError     `--on rtu:/dev/ttyUSB0@fast`, `--device 5=no-such-profile`, `--where "unit ="`
#   ProfileError   a profile whose area ends before it begins (file, key, what would be right)
#   InputError     a capture that is absent, unreadable or of another kind
#   CutError       a capture that ends in the middle of a record; raised after the last whole one
#   DamageError    a log in which a byte has changed; raised after all that is whole
#   LinkError      a port that is absent, busy or forbidden; an address in use
#   OutputError    a disk that is full while a log is written
#
# The text is one line, names the thing, and says what would be right.

from __future__ import annotations


class MbtoolError(Exception):
    """Any error this program raises on purpose; the text is one line for the user."""


class UsageError(MbtoolError):
    """What was asked for is not a thing one can ask for."""


class ProfileError(UsageError):
    """A device profile says something impossible."""

    def __init__(self, file: str, key: str, problem: str) -> None:
        super().__init__(f"{file}: {key}: {problem}")
        self.file = file
        self.key = key
        self.problem = problem


class InputError(MbtoolError):
    """An input could not be read."""


class CutError(InputError):
    """An input ends too early; all that came before it was delivered."""


class DamageError(InputError):
    """An input is damaged; all of it that is whole was delivered."""


class LinkError(MbtoolError):
    """A link could not be opened, or was lost."""


class OutputError(MbtoolError):
    """An output could not be written, or takes no more."""


def reason_of(error: OSError | ValueError) -> str:
    """The operating system's reason for an error, without its number and file name."""
    return getattr(error, "strerror", None) or str(error)
