"""Lets the plant set the clock of one program: time_ns() plus the number in the file SOAK_CLOCK.

Python loads this module at its start if this folder is on PYTHONPATH. Only the clock of the day is
set, as by `date --set`; the monotonic clocks stay.
"""

import os
import time
from pathlib import Path

_real_ns = time.time_ns
_file = Path(os.environ.get("SOAK_CLOCK", os.devnull))


def _set_ns() -> int:
    return _real_ns() + int(_file.read_text(encoding="ascii") or 0)


time.time_ns = _set_ns
