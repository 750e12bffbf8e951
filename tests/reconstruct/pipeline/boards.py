"""A wall with a board before it, coded, and settings short enough for tests of the whole reconstruction."""

from dataclasses import replace

import numpy as np
from scipy.ndimage import gaussian_filter, map_coordinates

from gs2ci.core.records import Shot, Truth
from gs2ci.reconstruct.fit.coarse.settings import CoarseSettings
from gs2ci.reconstruct.fit.coarse.stopping import HoldOut
from gs2ci.reconstruct.settings import Settings

VIEWS, HEIGHT, WIDTH = 6, 48, 64
FOCAL_PX = 60.0
QUICK = Settings(
    fit=CoarseSettings(iterations=160, densify_every=25, hold_out=HoldOut(look_every=20)),
    fits=1,
    poses="tracks",
    look_again=False,
    motion="off",
    seed=1,
)
SHORT = replace(QUICK, fit=replace(QUICK.fit, iterations=60, densify_every=20), fits=2)
# Long enough for a look, and for a population that changed: what bits are compared needs no more.
BRIEF = replace(SHORT, fit=replace(SHORT.fit, iterations=24, densify_every=8))
# For what is decided before a fit.
FIRST = replace(SHORT, fit=replace(SHORT.fit, iterations=1), fits=1, polish=None, uncertainty=False)


def wall_with_a_board(channels=3, wall_px=0.4, board_px=1.6):
    """Views [N, H, W, C] of a far wall and a near board before it, from a camera that moves sideways.

    From view to view the wall shifts by `wall_px` and the board by `board_px`.
    """
    rng = np.random.default_rng(4)
    margin, x, y = 16, np.arange(WIDTH, dtype=float), np.arange(HEIGHT, dtype=float)

    def texture():
        noise = gaussian_filter(rng.random((HEIGHT, WIDTH + 2 * margin, channels)), (2, 2, 0))
        return (noise - noise.min()) / np.ptp(noise)

    wall, board, views = texture(), texture(), []
    for i in range(VIEWS):
        move = i - (VIEWS - 1) / 2
        layers = [
            np.stack(
                [
                    map_coordinates(layer[..., c], np.meshgrid(y, x + margin + step * move, indexing="ij"), order=1)
                    for c in range(channels)
                ],
                axis=-1,
            )
            for layer, step in ((wall, wall_px), (board, board_px))
        ]
        place = x + board_px * move
        on_board = ((place > 18) & (place < 46))[None, :] & ((y > 12) & (y < 36))[:, None]
        views.append(np.where(on_board[..., None], layers[1], layers[0]))
    return np.stack(views).astype(np.float32)


def expose(views, masks=None, **parts):
    if masks is None:
        masks = (np.random.default_rng(5).random(views.shape[:3]) < 0.35).astype(np.float32)
    camera = np.array([[FOCAL_PX, 0, WIDTH / 2], [0, FOCAL_PX, HEIGHT / 2], [0, 0, 1]])
    shot = Shot(
        measurement=(masks[..., None] * views).sum(axis=0),
        masks=masks,
        weights=np.ones(len(views), np.float32),
        intrinsics=camera,
        truth=Truth(views=views),
    )
    return replace(shot, **parts).check()
