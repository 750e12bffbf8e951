"""`gs2ci live`: a bench in a browser while one aligns it.

Here: the arguments, and serving until the user stops it. Not here: the bench and its page (`gs2ci.rig.live`).
"""

import contextlib
import threading
from pathlib import Path

from rich.console import Console

from gs2ci.api.options import check_whole


def run(*, rig: Path, port: int = 8090, host: str = "127.0.0.1") -> None:
    """Show a bench in a browser until Ctrl-C: the camera's picture, masks, focus, registration, stage, one exposure.

    Nothing is shown, exposed or moved before a button is pressed. The first page holds the bench, others look on;
    when its page goes, or this command ends, everything is disarmed.

    Args:
        rig: The rig file.
        port: Of the local server; if it is taken, the next free one.
        host: Who may look, and press if nobody else does: 127.0.0.1 is this machine alone.

    Raises:
        Gs2ciError: A device does not answer, the rig file cannot be, or no port can be had.
    """
    check_whole("--port", port, 0, 65_535, remedy="leave --port out, or give 0 for any that is free")
    from gs2ci.rig.live.bench import LiveBench
    from gs2ci.rig.live.server import LiveServer
    from gs2ci.rig.opening import load_rig

    bench = LiveBench(load_rig(rig))
    bench.begin()
    try:
        server = LiveServer(bench, host, port)
        try:
            address = f"http://{'localhost' if host == '0.0.0.0' else host}:{server.port}"  # noqa: S104
            Console().print(f"the bench is at {address}; Ctrl-C ends this", soft_wrap=True, highlight=False)
            with contextlib.suppress(KeyboardInterrupt):
                wait_for_the_end()
        finally:
            server.stop()
    finally:
        bench.close()


def wait_for_the_end() -> None:
    """Wait for Ctrl-C."""
    threading.Event().wait()
