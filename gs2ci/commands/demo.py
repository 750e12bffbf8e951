"""`gs2ci demo`: a simulated bench takes one exposure of a photographed scene, and the scene is recovered from it.

Here: the order rig file → capture → reconstruct. Not here: the rig file (`gs2ci.api.demonstration`), the bench
(`gs2ci.commands.capture`), the reconstruction (`gs2ci.commands.reconstruct`).
"""

from pathlib import Path
from typing import Annotated, Any

import tyro

from gs2ci.api.demonstration import check_demo, check_demo_place, demo_rig
from gs2ci.api.derived import with_options_of
from gs2ci.commands import capture, reconstruct
from gs2ci.commands.answers import AsJson, answered


@with_options_of(demo_rig, without=("path",))
def run(
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])] = Path("runs/demo"),
    *,
    json: AsJson = False,
    **options: Any,
) -> Path:
    """Take one coded exposure of a motorcycle with a simulated bench, and recover the scene.

    The drivers are the real ones; the devices below their ports and the world around them are simulated.

    Args:
        output: The folder for rig file, shot file and run folder; an earlier demonstration there is replaced, and
            nothing else.

    Returns:
        The run folder.
    """
    check_demo(**options)
    from gs2ci.core.storage.sealing import partial_of
    from gs2ci.evaluate.whole_folder import check_destination

    check_destination(output / "run", overwrite=True)
    check_demo_place(output)
    shot = output / "shot.h5"
    rig = demo_rig(output / "rig.toml", **options)
    partial_of(shot).unlink(missing_ok=True)  # an interrupted demonstration holds no data worth keeping
    with answered(json):  # the run is the answer
        capture.take(rig, shot, overwrite=True)
    return reconstruct.run(shot, output / "run", overwrite=True, json=json)
