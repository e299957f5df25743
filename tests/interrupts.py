"""Interrupts the program at random moments: python -m tests.interrupts --moments 200.

Starts the installed script and `python -m mbtool`, and sends SIGINT between the start and the usual
end. The program must end with exit code 130 and one line, or have done its work. While Python
itself starts, mbtool cannot do anything about a signal; the count of these moments is printed.
"""

from __future__ import annotations

import argparse
import random
import signal
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path

import mbtool
from mbtool.cli import exit_codes

_FORMS = [[str(Path(sys.executable).parent / "mbtool")], [sys.executable, "-m", "mbtool"]]
_COMMAND = ["devices", "fa3-at1m8x"]
_PATIENCE_S = 120
_PACKAGE = str(Path(mbtool.__file__).parent)


def _start(form: list[str]) -> subprocess.Popen[str]:
    # A shell starts a background job with SIGINT ignored, which the child would inherit.
    return subprocess.Popen(
        [*form, *_COMMAND],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )


def ending(code: int, output: str, told: str) -> str:
    """Name how an interrupted process has ended; the name of a wrong end begins with WRONG."""
    if (code, told) == (exit_codes.INTERRUPTED, "interrupted\n"):
        return "one line and 130"
    if (code, told) == (exit_codes.DONE, "") and output:
        return "had done its work"
    if (code, told) == (-signal.SIGINT, ""):
        return "before Python takes signals: ended by the signal"
    if told.endswith("KeyboardInterrupt\n") and _PACKAGE not in told:
        return "while Python starts: its traceback"
    return f"WRONG: {code}, {told}"


def _main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--moments", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    chosen = parser.parse_args()
    source = random.Random(chosen.seed)
    counts: Counter[str] = Counter()
    for form in _FORMS:
        begun = time.monotonic()
        _start(form).communicate(timeout=_PATIENCE_S)
        usual_s = time.monotonic() - begun
        for _ in range(chosen.moments // len(_FORMS)):
            with _start(form) as process:
                time.sleep(source.uniform(0, 1.1 * usual_s))
                process.send_signal(signal.SIGINT)
                output, told = process.communicate(timeout=_PATIENCE_S)
            counts[ending(process.returncode, output, told)] += 1
    for name, count in counts.most_common():
        sys.stdout.write(f"{count:5} {name}\n")
    return int(any(name.startswith("WRONG") for name in counts))


if __name__ == "__main__":
    sys.exit(_main())
