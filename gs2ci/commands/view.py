"""`gs2ci view`: a run's scene and cameras in the browser.

Here: the arguments, and serving until the user stops it. Not here: what is shown (`gs2ci.evaluate.viewer`).
"""

import contextlib
import threading
from pathlib import Path
from typing import Annotated, Any

import tyro

from gs2ci.api.derived import with_options_of
from gs2ci.api.options import check_whole
from gs2ci.api.runs import Run
from gs2ci.commands.lines import say


@with_options_of(Run.view, without=("self",))
def run(
    folder: Annotated[Path, tyro.conf.Positional],
    /,
    **options: Any,
) -> None:
    """Show a run's scene and its cameras in the browser, until Ctrl-C.

    Needs the extra `view`: pip install 'gs2ci[view]'.

    Args:
        folder: A run folder, as `gs2ci reconstruct` writes it.

    Raises:
        Gs2ciError: viser is not installed, the folder is no run or damaged, or no port is free.
    """
    check_whole("--port", options["port"], 0, 65_535, remedy="leave --port out, or give 0 for any that is free")
    from gs2ci.evaluate.viewer import load_scene, serve

    scene = load_scene(folder)
    server = serve(scene, **options)
    found = f"{len(scene.means)} Gaussians, {len(scene.camera_to_world)} cameras"
    try:
        say(f"Ctrl-C ends this; {found} at {server.address}")
        with contextlib.suppress(KeyboardInterrupt):
            threading.Event().wait()
    finally:
        server.stop()
