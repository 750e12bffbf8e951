"""Scenes as the web viewer Spark draws them, in headless Chromium: from a file and the cameras of a run to pictures.

Here: the server of files, the cameras in the conventions of three.js, the pictures. Not here: what they are compared
with (`tests/clients/__main__.py`). Spark and three.js are installed from npm into a folder.
"""

import base64
import functools
import http.server
import json
import shutil
import threading
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from tests.evaluate.pages.conftest import NAMES, Pipe, Tab
from tests.patience import HANG_S

NEAR_SHARE, FAR_SHARE = 1e-3, 1e3
"""Of the distance looked at: where Spark clips."""


class _Quiet(http.server.SimpleHTTPRequestHandler):
    def log_message(self, *_: Any) -> None:
        """Say nothing."""


@contextmanager
def served(folder: Path) -> Iterator[str]:
    """Serve a folder on this machine's own address."""
    handler = functools.partial(_Quiet, directory=str(folder))
    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler)
    thread = threading.Thread(target=server.serve_forever, daemon=True)
    thread.start()
    try:
        yield f"http://127.0.0.1:{server.server_address[1]}"
    finally:
        server.shutdown()
        server.server_close()


@contextmanager
def browser(profile: Path) -> Iterator[Tab]:
    """Open a tab of a headless Chromium."""
    binary = next(found for name in NAMES if (found := shutil.which(name)))
    pipe = Pipe(binary, profile)
    try:
        target = pipe.ask("Target.createTarget", {"url": "about:blank"})["targetId"]
        session = pipe.ask("Target.attachToTarget", {"targetId": target, "flatten": True})["sessionId"]
        tab = Tab(pipe, session)
        for domain in ("Page", "Runtime", "Network", "Log"):
            tab.ask(f"{domain}.enable")
        yield tab
    finally:
        pipe.close()


def projection(intrinsics: np.ndarray, size: tuple[int, int], near: float, far: float) -> np.ndarray:
    """Return the matrix of OpenGL that puts a point where a pinhole puts it, [4, 4]."""
    height, width = size
    matrix = np.zeros((4, 4))
    matrix[0, 0] = 2 * intrinsics[0, 0] / width
    matrix[1, 1] = 2 * intrinsics[1, 1] / height
    matrix[0, 2] = 1 - 2 * intrinsics[0, 2] / width
    matrix[1, 2] = 2 * intrinsics[1, 2] / height - 1
    matrix[2, 2], matrix[2, 3] = -(far + near) / (far - near), -2 * far * near / (far - near)
    matrix[3, 2] = -1
    return matrix


def drawn(
    node: Path,
    file: Path,
    world_to_camera: np.ndarray,
    intrinsics: np.ndarray,
    size: tuple[int, int],
    distance: float,
    *,
    axes: np.ndarray | None = None,
    options: Mapping[str, Any] | None = None,
) -> np.ndarray:
    """Draw a file in Spark as cameras see it, [N, H, W, 3], 0 to 1.

    Args:
        node: Folder with `node_modules` that holds three and @sparkjsdev/spark.
        file: The scene.
        world_to_camera: [N, 4, 4], OpenCV axes, in the file's own unit.
        intrinsics: [3, 3].
        size: Height and width.
        distance: To what the cameras look at, in the file's unit.
        axes: file_from_ours, [4, 4], where the file's axes (and unit) are not ours.
        options: Of SparkRenderer.
    """
    turn = np.eye(4) if axes is None else axes
    flip = np.diag([1.0, -1, -1, 1])
    cameras = []
    for pose in world_to_camera:
        to_world = np.linalg.inv(pose)
        placed = turn @ to_world
        # A scale in `axes` belongs to places and not to the camera's own axes.
        placed[:3, :3] /= np.cbrt(np.linalg.det(placed[:3, :3]))
        matrix = projection(intrinsics, size, NEAR_SHARE * distance, FAR_SHARE * distance)
        cameras.append({"pose": (placed @ flip).T.ravel().tolist(), "projection": matrix.T.ravel().tolist()})
    page = node / "spark.html"
    shutil.copyfile(Path(__file__).with_name("spark.html"), page)
    own = node / f"scene{file.suffix}"
    shutil.copyfile(file, own)
    with served(node) as address, browser(node / "profile") as tab:
        tab.ask("Page.navigate", url=f"{address}/spark.html")
        until = time.monotonic() + HANG_S
        while not tab.run("window.ready === true"):
            assert not tab.complaints, tab.complaints
            assert time.monotonic() < until
            time.sleep(0.05)
        asked = {"url": f"{address}/{own.name}", "width": size[1], "height": size[0]}
        asked |= {"cameras": cameras, "options": dict(options or {})}
        answer = tab.run(f"window.draw({json.dumps(asked)})")
    shown = [np.frombuffer(base64.b64decode(text), np.uint8).reshape(*size, 4) for text in answer["pictures"]]
    return np.stack(shown)[:, ::-1, :, :3] / 255.0
