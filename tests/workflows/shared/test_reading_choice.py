"""Which files are read as arrays."""

from __future__ import annotations

import subprocess
import sys
from typing import TYPE_CHECKING

from tests.logs.samples import transaction, write_log

if TYPE_CHECKING:
    from pathlib import Path


def test_numpy_is_not_loaded_for_a_file_that_arrays_cannot_read(tmp_path: Path) -> None:
    log = tmp_path / "a.mcap"
    write_log(log, [transaction()])
    code = (
        "import sys\n"
        "from mbtool.workflows.shared.reading import ReadingOptions\n"
        "from mbtool.workflows.shared.reading_choice import column_reading\n"
        "assert column_reading(sys.argv[1:], ReadingOptions()) is None\n"
        "assert 'numpy' not in sys.modules\n"
    )
    subprocess.run([sys.executable, "-c", code, log], check=True, timeout=60)
