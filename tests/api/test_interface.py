"""The names that `import mbtool` gives."""

from __future__ import annotations

import importlib
import subprocess
import sys

import pytest

import mbtool

HEAVY = {"asyncio", "dataclasses", "mcap", "msgspec", "numpy", "pyarrow", "re", "rich", "scapy"}
HEAVY |= {"serial", "typer", "typing"}


def test_importing_mbtool_loads_nothing_but_its_version() -> None:
    script = "import sys; before = set(sys.modules); import mbtool; print(*set(sys.modules)-before)"
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True
    )
    loaded = set(done.stdout.split())
    assert {one for one in loaded if one.startswith("mbtool")} == {"mbtool", "mbtool.version"}
    assert not HEAVY & loaded


def test_loading_the_pytest_plugin_loads_nothing_else_of_mbtool() -> None:
    script = "import sys, mbtool.pytest_plugin; print(*sys.modules)"
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True
    )
    loaded = {one for one in done.stdout.split() if one.startswith("mbtool")}
    assert loaded == {"mbtool", "mbtool.version", "mbtool.pytest_plugin"}


def test_reading_a_file_and_playing_a_slave_load_no_table_and_no_command_line() -> None:
    script = "import sys, mbtool; mbtool.open, mbtool.Slave, mbtool.sniff; print(*sys.modules)"
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True
    )
    assert not {"rich", "typer", "scapy", "numpy", "pyarrow"} & set(done.stdout.split())


@pytest.mark.parametrize("name", mbtool.__all__)
def test_each_public_name_is_there_and_says_what_it_is(name: str) -> None:
    value = getattr(mbtool, name)
    assert isinstance(value, str) or value.__doc__
    assert name in dir(mbtool)


def test_no_name_is_hidden_by_a_package_of_mbtool() -> None:
    packages = {one.partition(".")[2] for one in sys.modules if one.startswith("mbtool.")}
    assert not set(mbtool.__all__) & packages


def test_a_name_that_is_not_there_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="module 'mbtool' has no attribute 'opne'"):
        importlib.import_module("mbtool").opne  # noqa: B018


def test_errors_are_of_one_class() -> None:
    with pytest.raises(mbtool.MbtoolError, match=r"nothing\.pcap: there is no such file"):
        mbtool.open("nothing.pcap")
