"""Fixtures that several test files use."""

import os
from pathlib import Path

import pytest


@pytest.fixture(scope="session")
def shared() -> Path:
    """The folder of published data that stands beside the repository; tests skip without it."""
    beside = Path(__file__).resolve().parents[1].parent / "shared"
    folder = Path(os.environ.get("WROD_SHARED", beside))
    if not folder.is_dir():
        pytest.skip("the folder of published data (../shared) is not here")
    return folder
