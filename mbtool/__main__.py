"""The program's first lines: they take Ctrl-C before anything else is loaded."""

# Loading the command line takes a few tenths of a second. Until it takes the signals itself, there
# is nothing to be completed, so the program leaves at once. What is imported here is imported
# before the signals are taken, so it is little.

from __future__ import annotations

import signal

from mbtool.cli.leaving import leave


def main() -> None:
    """Run the command line and exit with its code."""
    for number in (signal.SIGINT, signal.SIGTERM):
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, leave)
    from mbtool.cli.main import main as run_command_line

    run_command_line()


if __name__ == "__main__":
    main()
