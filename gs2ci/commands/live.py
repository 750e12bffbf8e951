"""`gs2ci live`: a bench in the browser while the user aligns it.

Here: the arguments, and serving until the user stops it. Not here: the bench and its page (`gs2ci.api.rigs`).
"""

import contextlib
import threading
from pathlib import Path
from typing import Any

from gs2ci.api.derived import with_options_of
from gs2ci.api.rigs import OpenRig, open_rig
from gs2ci.commands.lines import say


@with_options_of(OpenRig.live, without=("self",))
def run(*, rig: Path, **options: Any) -> None:
    """Show a bench in a browser until Ctrl-C: the camera's picture, masks, focus, registration, stage, one exposure.

    Nothing is shown, exposed or moved before a button is pressed. Only who has the printed address, which holds a
    secret, may connect; the first page that does controls the bench, others only watch. When that page closes, or
    this command ends, everything is disarmed.

    Args:
        rig: The rig file.

    Raises:
        Gs2ciError: A device does not answer, the rig file is invalid, or no port is free.
    """
    with open_rig(rig) as opened, opened.live(**options) as page:
        # Nothing follows the address: terminals and people take a semicolon for a part of it.
        say(f"Ctrl-C ends this; the bench is at {page.address}")
        with contextlib.suppress(KeyboardInterrupt):
            wait_for_the_end()


def wait_for_the_end() -> None:
    """Wait for Ctrl-C."""
    threading.Event().wait()
