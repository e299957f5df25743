"""mbtool as some installers leave it: compiled modules without their sources."""

from __future__ import annotations

import compileall
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import mbtool
from mbtool.devices.schema import profile_schema


@pytest.fixture(scope="module")
def compiled(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder that holds the package, but no source file."""
    folder = tmp_path_factory.mktemp("compiled")
    package = folder / "mbtool"
    shutil.copytree(
        Path(mbtool.__file__).parent, package, ignore=shutil.ignore_patterns("__pycache__")
    )
    assert compileall.compile_dir(package, quiet=1, legacy=True)
    for source in package.rglob("*.py"):
        source.unlink()
    return folder


def _devices(folder: Path, argument: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "mbtool", "devices", argument],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": str(folder)},
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )


def test_schema_has_its_descriptions_without_sources(compiled: Path) -> None:
    done = _devices(compiled, "schema")
    assert (done.returncode, done.stderr) == (0, "")
    assert json.loads(done.stdout) == profile_schema()


def test_missing_key_is_named_without_sources(compiled: Path) -> None:
    (compiled / "bad.toml").write_text('name = "pump"\n')
    done = _devices(compiled, "./bad.toml")
    assert done.returncode == 2
    assert "bad.toml: title: this key is missing: the device's full name" in done.stderr
    assert "Traceback" not in done.stderr
