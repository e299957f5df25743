"""All public SunSpec models, where a folder of them is named."""

from __future__ import annotations

import os

import pytest

from mbtool.workflows.shared.sunspec_devices import SunSpecFolder

FOLDER = "MBTOOL_SUNSPEC_MODELS"
"""The variable with the folder: json/ of a copy of github.com/sunspec/models."""


def test_all_public_models_can_be_imported() -> None:
    if FOLDER not in os.environ:
        pytest.skip(f"no SunSpec models: set {FOLDER} to their folder")
    count, wrong = SunSpecFolder(os.environ[FOLDER]).try_all()
    assert wrong == []
    assert count > 100
