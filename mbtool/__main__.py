"""The start of the program: handles Ctrl-C before anything else is loaded."""

# Loading the command line takes a few tenths of a second. Until cli/main.py sets its signal
# handlers, no output has to be completed, so a signal ends the program at once. Loading Python's
# module `signal` takes as long as loading all other modules here, so sys.excepthook handles Ctrl-C
# until then. If Ctrl-C comes earlier, while Python itself starts, Python prints its own traceback.
#
# When the interpreter ends, it searches all objects for cyclic garbage several times, which takes a
# fifth of the time of a short command. The system frees the memory anyway, so gc.freeze() excludes
# all objects from that search.

from __future__ import annotations

import os
import sys

TYPE_CHECKING = False  # Type checkers take this name for True; importing typing takes milliseconds.

if TYPE_CHECKING:
    from types import TracebackType


def leave(*_: object) -> None:
    """Print one line and end the process at once, even in the middle of an import."""
    try:  # noqa: SIM105 - importing contextlib takes milliseconds.
        os.write(2, b"interrupted\n")
    except OSError:
        pass  # Standard error is closed.
    os._exit(130)  # exit_codes.INTERRUPTED, without an import


def _leave_or_show(
    kind: type[BaseException], error: BaseException, trace: TracebackType | None
) -> None:
    if issubclass(kind, KeyboardInterrupt):
        leave()
    if issubclass(kind, MemoryError):
        os.write(2, b"mbtool: this process may use no more memory; see ulimit -v\n")
        os._exit(3)  # exit_codes.UNREADABLE
    sys.__excepthook__(kind, error, trace)


def main() -> None:
    """Run the command line and exit with its code."""
    import gc
    import signal

    hangup = getattr(signal, "SIGHUP", signal.SIGTERM)  # Windows has no SIGHUP.
    for number in (signal.SIGINT, signal.SIGTERM, hangup):
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, leave)
    from mbtool.cli.main import main as run_command_line

    try:
        run_command_line()
    finally:
        gc.freeze()


sys.excepthook = _leave_or_show

if __name__ == "__main__":
    main()
