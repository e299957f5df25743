"""Checks exported configurations with Home Assistant's own schema of its integration Modbus.

`python tests/devices/exporting/home_assistant_schema.py FILE.yaml...`, in an environment of its own
that has Home Assistant: docs/devices.md says how to make one.
"""

from __future__ import annotations

import sys

import yaml
from homeassistant.components.modbus import CONFIG_SCHEMA


def main(paths: list[str]) -> int:
    """Print how many values of each kind are taken; the answer is 1 if a file is refused."""
    refused = 0
    for path in paths:
        with open(path, encoding="utf-8") as file:
            config = yaml.safe_load(file)
        try:
            hubs = CONFIG_SCHEMA(config)["modbus"]
        except Exception as error:
            print(f"{path}: {error}")
            refused += 1
            continue
        counts = [
            f"{len(entries)} {platform}"
            for hub in hubs
            for platform, entries in hub.items()
            if isinstance(entries, list)
        ]
        print(f"{path}: {', '.join(counts) or 'no values'}")
    return int(refused > 0)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
