"""Where the shared measurements lie: GS2CI_SHARED_DATA, or ../shared/data beside the checkout."""

import os
from pathlib import Path

import pytest


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Get the folder of shared measurements, or skip where there is none."""
    given = os.environ.get("GS2CI_SHARED_DATA")
    folder = Path(given) if given else Path(__file__).resolve().parents[3] / "shared" / "data"
    if not folder.is_dir():
        pytest.skip(f"no shared measurements at {folder}; set GS2CI_SHARED_DATA to their folder")
    return folder
