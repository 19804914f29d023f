"""Fixtures for all rooms."""

import os
from pathlib import Path

import pytest


@pytest.fixture(scope="session")
def data_folder() -> Path:
    """The folder of real recordings; a test that asks for it is skipped, and says so, when there is none."""
    folder = os.environ.get("INVDYN_DATA")
    if not folder:
        pytest.skip("needs real recordings: set INVDYN_DATA")
    return Path(folder).expanduser()
