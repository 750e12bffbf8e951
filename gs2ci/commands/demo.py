"""`gs2ci demo`: a simulated bench takes one exposure of a photographed scene, and what can be recovered from it.

Here: the order rig file → capture → reconstruct. Not here: the rig file (`gs2ci.api.demonstration`), the bench
(`gs2ci.commands.capture`), the reconstruction (`gs2ci.commands.reconstruct`).
"""

from pathlib import Path
from typing import Annotated

import tyro

from gs2ci.api.demonstration import check_demo, demo_rig
from gs2ci.commands import capture, reconstruct


def run(
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])] = Path("runs/demo"),
    *,
    views: int = 8,
    height: int = 272,
    width: int = 400,
    parallax_px: float = 12.0,
    seed: int = 0,
) -> Path:
    """Expose a simulated bench once to a motorcycle behind changing masks, and recover what it saw.

    The drivers are the real ones; the devices below their ports and the world around them are simulated.

    Args:
        output: The folder for rig file, shot file and run folder; an earlier demonstration there is replaced.
        views: Masks during the exposure.
        height: Of the measurement, in pixels, a multiple of 2.
        width: Of the measurement, in pixels, a multiple of 4.
        parallax_px: How far near and far shift against each other during the exposure.
        seed: Of masks and noise.

    Returns:
        The run folder.
    """
    check_demo(views, height, width, parallax_px, seed)
    from gs2ci.core.storage.sealing import partial_of
    from gs2ci.evaluate.run_folder import check_destination

    check_destination(output / "run", overwrite=True)
    shot = output / "shot.h5"
    rig = demo_rig(output / "rig.toml", views=views, height=height, width=width, parallax_px=parallax_px, seed=seed)
    partial_of(shot).unlink(missing_ok=True)  # an interrupted demonstration is nobody's data
    capture.run(rig=rig, out=shot, overwrite=True)
    return reconstruct.run(shot, output / "run", overwrite=True)
