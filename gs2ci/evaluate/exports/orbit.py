"""A short film of a scene: the camera makes one circle in front of the scene and ends where it began.

Here: the poses of the orbit, and the film as GIF or MP4. Not here: rendering.
"""

import re
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np

from gs2ci.core.arrays import F32, F64, U8
from gs2ci.core.errors import InputError, StorageError
from gs2ci.core.whole_file import write_whole

FRAMES: Final = 48
FRAMES_PER_S: Final = 24
_COLOURS: Final = (1, 13, 6)
_SMPTE_170: Final = 3
_KEY_FRAME: Final = re.compile(rb"([\x80-\x83\x88-\x8b]\x49\x83\x42)(.)", re.DOTALL)
# The orbit's radius as a share of the distance looked at, at least; a wider recovered path widens it.
_LEAST_SHARE: Final = 0.04
_MOST_SHARE: Final = 0.25


def orbit_poses(world_to_camera: F64, distance: float, count: int = FRAMES) -> F64:
    """Return the poses of an orbit round the middle of a path, [count, 4, 4], world to camera.

    Args:
        world_to_camera: The recovered path, [N, 4, 4].
        distance: To the point that stays in the middle of the picture, along the middle camera's axis.
        count: Of frames.
    """
    to_world = np.linalg.inv(world_to_camera)
    middle = to_world[len(to_world) // 2]
    reach = float(np.linalg.norm(to_world[:, :3, 3] - middle[:3, 3], axis=1).max())
    radius = float(np.clip(reach, _LEAST_SHARE * distance, _MOST_SHARE * distance))
    poses = []
    for angle in 2 * np.pi * np.arange(count) / count:
        # In the middle camera's axes: a circle in its image plane, looking at one point ahead.
        eye = radius * np.array([np.cos(angle), 0.5 * np.sin(angle), 0.0])
        ahead = np.array([0.0, 0.0, distance]) - eye
        ahead /= np.linalg.norm(ahead)
        right = np.cross([0.0, 1.0, 0.0], ahead)
        right /= np.linalg.norm(right)
        local = np.eye(4)
        local[:3, :3] = np.stack([right, np.cross(ahead, right), ahead])
        local[:3, 3] = -local[:3, :3] @ eye
        poses.append(local @ np.linalg.inv(middle))
    return np.stack(poses)


def write_film(path: Path, frames: F32) -> Path:
    """Write frames as a film that repeats endlessly.

    Args:
        path: Ends in .gif, or in .mp4 (VP9, which browsers play).
        frames: [F, H, W, 3], full scale 1.

    Returns:
        The path.

    Raises:
        InputError: It ends otherwise, or this machine's OpenCV has no encoder for it.
        StorageError: The disk refuses.
    """
    shown: U8 = np.round(255 * np.clip(frames, 0, 1)).astype(np.uint8)
    if path.suffix == ".gif":
        import imageio.v3 as imageio  # noqa: PLC0415  only films need it

        delays = gif_delays_ms(len(shown))
        duration = delays if len(shown) > 1 else delays[0]
        content = imageio.imwrite("<bytes>", shown, extension=".gif", duration=duration, loop=0)
        return write_whole(path, content)
    if path.suffix != ".mp4":
        raise InputError(f"a film {path.name}", allowed="a name that ends in .gif or .mp4")
    # Encoders of 4:2:0 video take even sides alone: the last row and column are shown twice.
    shown = np.pad(shown, ((0, 0), (0, shown.shape[1] % 2), (0, shown.shape[2] % 2), (0, 0)), mode="edge")
    height, width = shown.shape[1:3]
    code: Any = cv2.VideoWriter.fourcc(*"vp09")
    writer = cv2.VideoWriter(str(path), code, FRAMES_PER_S, (width, height))
    if not writer.isOpened():
        raise InputError(f"{path} cannot be encoded or written here", remedy="choose a folder that exists, or --to gif")
    for frame in shown:
        writer.write(np.ascontiguousarray(frame[..., ::-1]))
    writer.release()
    # The writer does not say that the disk has refused.
    if int(cv2.VideoCapture(str(path)).get(cv2.CAP_PROP_FRAME_COUNT)) != len(shown):
        raise StorageError(
            f"{path} cannot be written: not all of its {len(shown)} frames are in it",
            remedy="check the folder and its free space",
        )
    path.write_bytes(with_colours_told(path.read_bytes()))
    return path


def gif_delays_ms(count: int) -> list[int]:
    """Return how long each frame of a GIF is shown, ms: its clock counts hundredths, and 24 frames a second do not."""
    ends = np.round(100 * np.arange(count + 1) / FRAMES_PER_S).astype(int)
    return [10 * int(delay) for delay in np.diff(ends)]


def with_colours_told(film: bytes) -> bytes:
    """Say in an MP4 file of VP9 what its colours mean, which OpenCV leaves open, so that players guess by the size.

    The box `vpcC` (webmproject.org, "VP Codec ISO Media File Format Binding") holds primaries, transfer and matrix as
    numbers of ITU-T H.273: BT.709, sRGB, and the matrix of BT.601, by which OpenCV's ffmpeg makes YUV. Decoders believe
    each key frame more (VP9 bitstream specification, 7.2: after the sync code three bits of `color_space`).
    """
    at = film.find(b"vpcC")
    if at < 0:
        return film
    # After the name: version and flags in 4 bytes, profile, level, and depth with subsampling and range.
    at += 4 + 4 + 3
    film = film[:at] + bytes(_COLOURS) + film[at + len(_COLOURS) :]
    # By chance alone the marker of a key frame and the sync code stand in one of 2²⁸ places.
    return _KEY_FRAME.sub(lambda found: found[1] + bytes([found[2][0] & 0x1F | _SMPTE_170 << 5]), film)
