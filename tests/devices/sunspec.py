"""A SunSpec device for tests: models written by hand, and its registers."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from pathlib import Path

BASE = 40000
MINUS_1 = 0xFFFF
COMMON = {
    "id": 1,
    "group": {
        "name": "common",
        "type": "group",
        "points": [
            {"name": "ID", "type": "uint16", "size": 1, "value": 1},
            {"name": "L", "type": "uint16", "size": 1},
            {"name": "Mn", "type": "string", "size": 16},
            {"name": "Md", "type": "string", "size": 16},
            {"name": "DA", "type": "uint16", "size": 1, "access": "RW"},
        ],
    },
}
METER = {
    "id": 64900,
    "group": {
        "name": "meter",
        "type": "group",
        "points": [
            {"name": "ID", "type": "uint16", "size": 1, "value": 64900},
            {"name": "L", "type": "uint16", "size": 1},
            {"name": "A", "type": "uint16", "size": 1, "units": "A", "sf": "A_SF"},
            {"name": "A_SF", "type": "sunssf", "size": 1},
        ],
        "groups": [
            {
                "name": "phase",
                "type": "group",
                "count": 0,
                "points": [
                    {"name": "A", "type": "int16", "size": 1, "units": "A", "sf": "A_SF"},
                    {"name": "V", "type": "int16", "size": 1, "units": "V", "sf": "V_SF"},
                    {"name": "V_SF", "type": "sunssf", "size": 1},
                ],
            }
        ],
    },
}
UNKNOWN = 64999
"""The number of a model that has no file."""
MAKER, DEVICE = "Maker", "Meter 7"


def registers() -> dict[int, list[int]]:
    """What the device has, by first address: common, a meter with two phases, an unknown model."""
    common = [1, 33, *_text(MAKER), *_text(DEVICE), 126]
    phases = [70, 2300, MINUS_1, -80 & 0xFFFF, 2310, MINUS_1]
    blocks = [
        [0x5375, 0x6E53],
        common,
        [64900, 2 + len(phases), 235, MINUS_1, *phases],
        [UNKNOWN, 2, 5, 6],
        [0xFFFF, 0],
    ]
    at, device = BASE, {}
    for block in blocks:
        device[at] = block
        at += len(block)
    return device


def write_models(folder: Path, *models: dict[str, Any]) -> Path:
    """Write the files of models, as github.com/sunspec/models names them."""
    folder.mkdir()
    for model in models or (COMMON, METER):
        (folder / f"model_{model['id']}.json").write_text(json.dumps(model))
    return folder


def _text(text: str) -> list[int]:
    data = text.encode().ljust(32, b"\0")
    return [int.from_bytes(data[at : at + 2], "big") for at in range(0, len(data), 2)]
