"""The start of the program: handles Ctrl-C before anything else is loaded."""

# Loading the command line takes a few tenths of a second. Until main.py sets its signal handlers,
# no output has to be completed, so a signal ends the program at once. A signal during the imports
# of this file is not handled, so there are few imports.
#
# When the interpreter ends, it searches all objects for cyclic garbage several times, which takes a
# fifth of the time of a short command. The system frees the memory anyway, so gc.freeze() excludes
# all objects from that search.

from __future__ import annotations

import gc
import signal

from mbtool.cli.leaving import leave


def main() -> None:
    """Run the command line and exit with its code."""
    hangup = getattr(signal, "SIGHUP", signal.SIGTERM)  # Windows has no SIGHUP.
    for number in (signal.SIGINT, signal.SIGTERM, hangup):
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, leave)
    from mbtool.cli.main import main as run_command_line

    try:
        run_command_line()
    finally:
        gc.freeze()


if __name__ == "__main__":
    main()
