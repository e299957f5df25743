"""The start of mbtool.pyz: unpacks the packages once, as machine code cannot run from a zip."""

import os
import runpy
import sys
import tempfile
import zipfile
from contextlib import suppress
from pathlib import Path

_archive = Path(sys.argv[0]).resolve()
_cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "mbtool"
_place = _cache / f"{_archive.stat().st_mtime_ns:x}-{sys.version_info[0]}.{sys.version_info[1]}"
if not _place.is_dir():
    _cache.mkdir(parents=True, exist_ok=True)
    _unpacked = tempfile.mkdtemp(dir=_cache)
    with zipfile.ZipFile(_archive) as _zip:
        _zip.extractall(_unpacked)
    with suppress(OSError):  # Another process was sooner.
        os.rename(_unpacked, _place)
_packages = str(_place / "packages")
sys.path.insert(0, _packages)
# Processes that mbtool starts find the packages, too.
os.environ["PYTHONPATH"] = os.pathsep.join(
    one for one in (_packages, os.environ.get("PYTHONPATH")) if one
)
runpy.run_module("mbtool", run_name="__main__", alter_sys=True)
