"""A run's scene and cameras, served to a browser by viser.

Here: the contents, and the server. Not here: how long it is served (`gs2ci.commands.view`). viser, an extra of the
package, is imported only when something is served.
"""

import contextlib
import io
import socket
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np
import torch
from scipy.spatial.transform import Rotation

from gs2ci.core.arrays import F32, F64, U8
from gs2ci.core.door import LOCAL, MOST_CONNECTIONS, listening
from gs2ci.core.errors import InputError
from gs2ci.evaluate.exports.for_viewers import typical_depth
from gs2ci.evaluate.gate import Gate
from gs2ci.evaluate.pages.pictures import shrink, to_eight_bit
from gs2ci.evaluate.pages.run_evidence import read_run
from gs2ci.render.conventions import DILATION_PX2
from gs2ci.render.gaussians import rotation_matrices
from gs2ci.render.harmonics import colours_from
from gs2ci.render.ply import read_ply_scene

# viser keeps covariances in half precision, whose smallest number is 6e-8: scenes are scaled so that what the cameras
# look at is this far away.
SHOWN_DEPTH: Final = 10.0
# The largest size, in shown units, twice the square of which half precision holds: what lies far away is larger.
_LARGEST_SIZE: Final = 170.0
# Pictures on the cameras only need to be recognisable.
PICTURE_SIDE_PX: Final = 320
# A camera's symbol, as a share of the mean distance between neighbours, and of the depth where there is one camera.
SYMBOL_OF_STEP, SYMBOL_OF_DEPTH = 0.6, 0.05
SYMBOL_LINE_PX, SYMBOL_COLOUR = 1.5, (240, 130, 90)
# Where the slider shows everything, however unsure.
_ALL_PERCENT: Final = 100


@dataclass(frozen=True)
class ViewerScene:
    """The contents of the viewer, scaled so that the scene lies at `SHOWN_DEPTH`.

    Args:
        means: [G, 3].
        covariances: [G, 3, 3].
        colours: In [0, 1], [G, 3]; colours that depend on the viewing direction are those of the middle camera, because
            the viewer has one colour for each Gaussian.
        opacities: In [0, 1], [G, 1].
        camera_to_world: [N, 4, 4], OpenCV axes.
        fov: Vertical field of view, radians.
        aspect: Width of the cameras' field of view by its height, that of the pictures only if pixels are square.
        pictures: The recovered views, small, [N] of [h, w, 3].
        errors: Standard errors of the centres as shares of their distance from the middle camera, [G]; None if the
            scene has none.
    """

    means: F32
    covariances: F32
    colours: F32
    opacities: F32
    camera_to_world: F64
    fov: float
    aspect: float
    pictures: list[U8]
    errors: F32 | None = None

    @property
    def symbol(self) -> float:
        """Get how far a camera's symbol, with its picture, reaches ahead of it, in shown units."""
        steps = np.linalg.norm(np.diff(self.camera_to_world[:, :3, 3], axis=0), axis=1)
        most = SYMBOL_OF_DEPTH * SHOWN_DEPTH
        return float(np.clip(SYMBOL_OF_STEP * steps.mean(), 0.05 * most, most)) if len(steps) else most


def load_scene(folder: Path) -> ViewerScene:
    """Read a run folder for viewing.

    Raises:
        StorageError: The folder is no complete run.
        InputError: Its scene cannot be read, or is empty.
    """
    evidence = read_run(folder)
    read = read_ply_scene(Path(folder) / "scene.ply")
    gaussians = read.gaussians.map(torch.Tensor.float)
    if not len(gaussians):
        raise InputError(f"{Path(folder) / 'scene.ply'} holds no Gaussian", remedy="see report.html for why")
    poses = np.asarray(np.linalg.inv(evidence.world_to_camera), np.float64)
    middle = torch.from_numpy(evidence.world_to_camera[len(poses) // 2]).float()
    focal_x_px, focal_y_px = evidence.intrinsics.diagonal()[:2].tolist()
    scale = SHOWN_DEPTH / typical_depth(gaussians.means.double(), torch.from_numpy(evidence.world_to_camera))
    sizes = (scale * gaussians.log_scales.exp()).clamp(max=_LARGEST_SIZE)
    axes = rotation_matrices(gaussians.quaternions) * sizes[:, None, :]
    # What the fit added to variances in pixels of its views: the viewer adds as much in its own, which are smaller.
    px = scale * (gaussians.means @ middle[2, :3] + middle[2, 3]).clamp(min=0) / min(focal_x_px, focal_y_px)
    widened = (DILATION_PX2 * px**2).clamp(max=_LARGEST_SIZE**2)[:, None, None] * torch.eye(3)
    poses[:, :3, 3] *= scale
    height, width = evidence.views.shape[1:3]
    return ViewerScene(
        means=(scale * gaussians.means).numpy(),
        covariances=(axes @ axes.transpose(1, 2) + widened).numpy(),
        colours=colours_from(gaussians, middle).clamp(0, 1).numpy(),
        opacities=torch.sigmoid(gaussians.opacity_logits)[:, None].numpy(),
        camera_to_world=poses,
        fov=2 * float(np.arctan(height / (2 * focal_y_px))),
        aspect=(width / focal_x_px) / (height / focal_y_px),
        pictures=[shrink(to_eight_bit(view), PICTURE_SIDE_PX) for view in evidence.views],
        errors=None
        if read.standard_errors is None
        else _shares(read.standard_errors, gaussians.means.numpy(), middle.numpy()),
    )


@dataclass(frozen=True)
class Viewer:
    """A scene being served.

    Args:
        server: viser's server, on a port of this machine alone.
        gate: What lets those through to it who have the secret.
    """

    server: Any
    gate: Gate

    @property
    def address(self) -> str:
        """Get the address to open, with its secret."""
        return self.gate.address

    def get_port(self) -> int:
        """Get the port of the address."""
        return self.gate.port

    def stop(self) -> None:
        """End serving."""
        self.gate.stop()
        self.server.stop()


def serve(scene: ViewerScene, *, host: str, port: int) -> Viewer:
    """Start serving a scene; `stop()` of what is returned ends it.

    Args:
        scene: The contents.
        host: Address of the interface to listen on.
        port: Port to listen on; if it is in use, the next free one; 0 takes any.

    Raises:
        InputError: viser is not installed, or no port is free.
    """
    try:
        import viser  # noqa: PLC0415
    except ImportError as error:
        raise InputError("viewing a scene needs the package viser", remedy="pip install 'gs2ci[view]'") from error
    listener = listen(host, port)
    # However quiet it is asked to be, it prints its own address, which is not the one to open.
    with contextlib.redirect_stdout(io.StringIO()):
        server = viser.ViserServer(host=LOCAL[0], port=free_port(LOCAL[0], 0), verbose=False)
    # The share button would send the scene through a foreign server. A dark background stands for no light.
    server.gui.configure_theme(show_share_button=False, dark_mode=True)
    _show(server, scene)
    return Viewer(server, Gate("gs2ci view", listener, host, server.get_port()))


def free_port(host: str, port: int) -> int:
    """Find a free port, as `listen` does, and leave it free.

    Raises:
        InputError: As `listen`.
    """
    with listen(host, port) as listener:
        return int(listener.getsockname()[1])


def listen(host: str, port: int) -> socket.socket:
    """Listen on a port: this one or one of the next; any if it is 0.

    Raises:
        InputError: There is none, or the host is no address of this machine.
    """
    return listening(host, port, partial(socket.create_server, backlog=MOST_CONNECTIONS))


def _show(server: Any, scene: ViewerScene) -> None:
    server.scene.set_up_direction("-y")
    _show_surer(server, scene, _ALL_PERCENT)
    if scene.errors is not None:
        slider = server.gui.add_slider(
            "Hide what is less sure than, % of its distance",
            min=1,
            max=_ALL_PERCENT,
            step=1,
            initial_value=_ALL_PERCENT,
        )
        slider.on_update(lambda _: _show_surer(server, scene, slider.value))
    for index, (pose, picture) in enumerate(zip(scene.camera_to_world, scene.pictures, strict=True)):
        frustum = server.scene.add_camera_frustum(
            f"/cameras/{index + 1}",
            fov=scene.fov,
            aspect=scene.aspect,
            scale=scene.symbol * _volume_side(scene),
            thickness=SYMBOL_LINE_PX,
            thickness_units="screen",
            color=SYMBOL_COLOUR,
            image=picture,
            wxyz=Rotation.from_matrix(pose[:3, :3]).as_quat(scalar_first=True),
            position=pose[:3, 3],
        )
        frustum.on_click(lambda event, pose=pose: _step_into(event.client, pose))
    middle = scene.camera_to_world[len(scene.pictures) // 2]
    server.initial_camera.position = middle[:3, 3] + _before_symbols(scene) * middle[:3, 2]
    server.initial_camera.look_at = middle[:3, 3] + SHOWN_DEPTH * middle[:3, 2]
    server.initial_camera.up = -middle[:3, 1]
    server.initial_camera.fov = scene.fov


def _show_surer(server: Any, scene: ViewerScene, percent: float) -> None:
    """Show the Gaussians whose places are surer than so many per cent of their distance; all at the slider's end."""
    kept = np.ones(len(scene.means), bool)
    if scene.errors is not None and percent < _ALL_PERCENT:
        kept = 100 * scene.errors <= percent
        # One at least: what a browser makes of no Gaussians is its own affair.
        kept[np.argmin(scene.errors)] = True
    # A scene of the same name takes the place of the one before.
    server.scene.add_gaussian_splats(
        "/scene",
        centers=scene.means[kept],
        covariances=scene.covariances[kept],
        rgbs=scene.colours[kept],
        opacities=scene.opacities[kept],
    )


def _shares(errors: F32, means: F32, world_to_camera: F32) -> F32:
    """Return standard errors as shares of the distance from a camera, [G]."""
    distance = np.linalg.norm(means @ world_to_camera[:3, :3].T + world_to_camera[:3, 3], axis=1)
    return (errors / np.maximum(distance, np.finfo(np.float32).tiny)).astype(np.float32)


def _volume_side(scene: ViewerScene) -> float:
    """Return the side of a cube of the volume of a symbol that reaches ahead by 1.

    viser's `scale` is that side (`CameraFrustumVariants.tsx`, 1.1.1): the picture of a narrow lens lies several times
    as far ahead.
    """
    half_height = np.tan(scene.fov / 2)
    return float(np.cbrt(half_height * half_height * scene.aspect / 3))


def _before_symbols(scene: ViewerScene) -> float:
    """Return how far ahead of the middle camera no camera's symbol hides what it looks at.

    Symbols reach ahead of their cameras by their size. Where the path leads into the scene, half of the way is enough.
    """
    middle = scene.camera_to_world[len(scene.pictures) // 2]
    ahead = (scene.camera_to_world[:, :3, 3] - middle[:3, 3]) @ middle[:3, 2]
    return float(min(1.1 * scene.symbol + max(ahead.max(), 0.0), 0.5 * SHOWN_DEPTH))


def _step_into(client: Any, pose: F64) -> None:
    """Move the viewer to a camera's pose."""
    client.camera.position = pose[:3, 3]
    client.camera.look_at = pose[:3, 3] + SHOWN_DEPTH * pose[:3, 2]
    client.camera.up_direction = -pose[:3, 1]
