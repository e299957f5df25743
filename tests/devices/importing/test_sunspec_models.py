"""All public SunSpec models, where a folder of them is named."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from mbtool.devices.importing.sunspec import import_sunspec

FOLDER = "MBTOOL_SUNSPEC_MODELS"
"""The variable with the folder: json/ of a copy of github.com/sunspec/models."""


def test_all_public_models_can_be_imported() -> None:
    if FOLDER not in os.environ:
        pytest.skip(f"no SunSpec models: set {FOLDER} to their folder")
    models = sorted(Path(os.environ[FOLDER]).glob("model_*.json"))
    assert len(models) > 100
    for path in models:
        made = import_sunspec([(path.name, path.read_bytes())], path.stem)
        assert len(made.profile.points) > 2, path
