"""A worker that dies as it starts. Not a test, and a file of its own: a new process imports it, and little with it."""

import os
from pathlib import Path

from gs2ci.batch import cluster


def at_first(scheduler, key, serve=cluster._serve):
    """Die the first time that a worker starts in a folder; work from then on."""
    seen = Path(os.environ["GS2CI_TEST_SEEN"]) / "started"
    if not seen.exists():
        seen.touch()
        os._exit(1)
    serve(scheduler, key)
