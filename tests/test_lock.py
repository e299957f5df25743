from __future__ import annotations

from tests.lock import locked, requirements

REPORT = {
    "install": [
        {
            "metadata": {"name": "rich", "version": "14.0"},
            "download_info": {"archive_info": {"hashes": {"sha256": "ab"}}},
        },
        {"metadata": {"name": "mbtool", "version": "0"}, "download_info": {"dir_info": {}}},
    ]
}


def test_each_package_has_its_version_and_hash_and_mbtool_itself_is_left_out() -> None:
    packages = locked(REPORT)
    assert requirements(packages) == "rich==14.0 --hash=sha256:ab\n"
