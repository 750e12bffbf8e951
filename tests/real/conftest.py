"""Where the shared measurements lie; tests that use them skip, with the reason, where they are absent."""

import os
from pathlib import Path

import pytest


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Find the shared data: `GS2CI_SHARED_DATA`, or `../shared/data` beside the checkout."""
    beside = Path(__file__).resolve().parents[2].parent / "shared" / "data"
    folder = Path(os.environ.get("GS2CI_SHARED_DATA", beside))
    if not folder.is_dir():
        pytest.skip(f"no shared data: set GS2CI_SHARED_DATA, or put it at {beside}")
    return folder
