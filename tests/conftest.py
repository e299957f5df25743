"""Fixtures that every test may use."""

from __future__ import annotations

import signal
import sys
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

from tests.captures import FOLDER, public_folder

# How long an example takes depends on what else the machine does, so no test fails for it. Each run
# tries the same examples, so a test fails only where the code changed. To search new ones:
# pytest --hypothesis-profile=new-examples
settings.register_profile(
    "new-examples", deadline=None, suppress_health_check=[HealthCheck.too_slow]
)
settings.register_profile(
    "same-examples", settings.get_profile("new-examples"), derandomize=True, max_examples=25
)
settings.register_profile("quick", settings.get_profile("same-examples"), max_examples=10)
settings.load_profile("same-examples")

# --quick leaves these out: they start processes, keep to real times, try very many bytes or read
# many captures.
SLOW = frozenset((
    "adversary", "benchmarks", "differential", "end_to_end", "golden", "power_cuts", "properties",
    "cli/test_ask.py", "cli/test_decode.py", "cli/test_decode_folder.py", "cli/test_decode_jobs.py",
    "cli/test_decode_parquet.py",
    "cli/test_environments.py",
    "cli/test_line.py", "cli/test_main.py", "cli/test_output.py",
    "cli/test_replay.py", "cli/test_replay_slave.py", "cli/test_slave.py", "cli/test_sniff.py",
    "cli/test_status.py",
    "columns/test_equality.py", "columns/test_headers.py", "columns/test_lines.py",
    "cli/watching/test_app.py", "cli/watching/test_keys.py", "cli/watching/test_saving.py",
    "devices/test_wrong_profiles.py", "docs", "logs/test_damaged_logs.py", "logs/test_reader.py",
    "logs/test_writer.py",
    "replay/test_read_back.py", "serial_line/test_plants.py",
    "serial_line/test_stray_bytes.py",
    "sources/test_interface.py", "sources/test_line_guess.py",
    "sources/test_relay.py", "sources/test_serial_capture.py", "sources/test_two_taps.py",
    "sources/test_virtual_line.py", "test___main__.py", "test_mutants.py", "test_pytest_plugin.py",
    "workflows/test_check_attacks.py", "workflows/test_check_byte_times.py",
    "workflows/test_check_wrong_settings.py", "workflows/test_conformance.py",
    "workflows/test_decode_cluster.py", "workflows/test_decode_job.py",
))  # fmt: skip
_HERE = Path(__file__).parent


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--update-golden",
        action="store_true",
        help="Write what captures and simulated plants decode to into their expected files.",
    )
    parser.addoption(
        "--quick",
        action="store_true",
        help="Leave slow tests out, and try a tenth as many examples in the others.",
    )


def pytest_configure(config: pytest.Config) -> None:
    # Under nohup SIGHUP is ignored, also in the programs that tests start and end with it.
    if sys.platform != "win32" and signal.getsignal(signal.SIGHUP) is signal.SIG_IGN:
        signal.signal(signal.SIGHUP, signal.SIG_DFL)
    if config.getoption("--quick"):
        settings.load_profile("quick")


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    if not config.getoption("--quick") or not collection_path.is_relative_to(_HERE):
        return None
    return collection_path.relative_to(_HERE).as_posix() in SLOW or None


@pytest.fixture(scope="session")
def public_captures() -> Path:
    """The folder of captures made by others; skips where it is absent."""
    folder = public_folder()
    if not folder.is_dir():
        pytest.skip(f"no captures made by others: set {FOLDER} to their folder")
    return folder
