"""VGGT (Wang et al. 2025) by ONNX Runtime: poses and depth of a few views at once, from a file of the user.

Here: the model's signature, the conversion of our views to its images and back, and an error for every way in which its
output can be wrong. Not here: which outputs are accepted (`paper.hierarchy`), how such a file is made
(`vggt_export`).

A model takes images [S, 3, H, W] or [1, S, 3, H, W], float32 in [0, 1], sides multiples of 14, and returns, by name,
with or without the leading 1:

    pose_enc or pose_encoding   [S, 9]: translation, quaternion xyzw, vertical and horizontal field of view
      or extrinsics [S, 3, 4] and intrinsics [S, 3, 3]; world to camera, OpenCV axes
    depth or depth_map          [S, H, W, 1] or [S, H, W]

Other outputs are ignored.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from gs2ci.core.arrays import F32, F64, Size
from gs2ci.core.cameras import rigid
from gs2ci.core.errors import InputError, NumericsError
from gs2ci.reconstruct.learned.onnx_models import OnnxModel, fixed_side, run_model

_PATCH: Final = 14
LONGER_SIDE: Final = 518  # what it was trained at: the longer side
_REMEDY: Final = "export it again with `gs2ci models export-vggt`, or take --geometry tracks"
_POSES: Final = ("pose_enc", "pose_encoding")
_DEPTHS: Final = ("depth", "depth_map")
# Tolerance: half precision inside the network gives about three digits.
_ROTATION_TOLERANCE: Final = 0.05


@dataclass(frozen=True)
class Prediction:
    """The model's prediction for views, in their own order and size.

    Args:
        world_to_camera: [N, 4, 4], rigid; in the frame and unit that the model chose.
        focal_px: Of each view, [N].
        depth: Along the optical axis, [N, H, W], not checked for its sign.
    """

    world_to_camera: F64
    focal_px: F64
    depth: F32


class Vggt(OnnxModel):
    """A VGGT model in an ONNX file; see `OnnxModel`."""

    kind = "a VGGT model"
    called = (
        "images [S, 3, H, W] or [1, S, 3, H, W] float32; pose_enc (or extrinsics and intrinsics), depth, depth_conf"
    )
    missing = "`gs2ci models export-vggt` makes one; `gs2ci models add vggt FILE`"
    wrap = _REMEDY

    def is_one(self) -> bool:
        """Tell by inputs and outputs whether the file is of this kind."""
        names = {one.name for one in self.outputs}
        posed = names.intersection(_POSES) or {"extrinsics", "intrinsics"} <= names
        return self.ranks in ([4], [5]) and bool(posed and names.intersection(_DEPTHS))

    @property
    def taken(self) -> str:
        """Get the number of views that it takes, in words."""
        count = fixed_side(self.inputs[0].shape[-4])
        return "any number of views" if count is None else f"exactly {count} views"

    def predict(self, views: F32, order: Sequence[int]) -> Prediction:
        """Predict poses and depth of views, [N, H, W, C] in [0, 1], given in some order; returned in that of `views`.

        Raises:
            InputError: The file's number of views is fixed, and differs.
            NumericsError: The model failed, an output has another shape, is not finite, or is no rotation.
        """
        shape = self.inputs[0].shape[-4:]
        wanted = fixed_side(shape[0])
        if wanted not in (None, len(views)):
            raise InputError(
                f"{self.path.name} takes {wanted} views, not {len(views)}",
                remedy="export the model with a dynamic view axis",
            )
        frame = _Frame.of(views.shape[1:3], fixed_side(shape[2]), fixed_side(shape[3]))
        images = np.stack([frame.filled(views[i]) for i in order]).transpose(0, 3, 1, 2)
        fed = np.ascontiguousarray(images if len(self.inputs[0].shape) == 4 else images[None], np.float32)
        answer = run_model(self._session, self.path.name, {self.inputs[0].name: fed}, _REMEDY)
        back = np.argsort(order)
        count, (rows, columns) = len(views), frame.total
        poses, focal = self._cameras(answer, count, frame)
        depth = self._output(answer, _DEPTHS, (count, rows, columns))
        return Prediction(poses[back], focal[back], frame.restored(depth[back]))

    def _cameras(self, answer: Mapping[str, Any], count: int, frame: "_Frame") -> tuple[F64, F64]:
        """Read world-to-camera matrices, [S, 4, 4], and focal lengths in px of our views, [S]."""
        if any(name in answer for name in _POSES):
            encoded = self._output(answer, _POSES, (count, 9)).astype(np.float64)
            lengths = np.linalg.norm(encoded[:, 3:7], axis=1)
            if not (lengths > _ROTATION_TOLERANCE).all():
                raise NumericsError(f"{self.path.name} returned a quaternion of length zero", remedy=_REMEDY)
            poses = rigid(Rotation.from_quat(encoded[:, 3:7]).as_matrix(), encoded[:, :3])
            half = np.tan(np.clip(encoded[:, 7:], 1e-3, np.pi - 1e-3) / 2)
            focal = np.array(frame.total) / 2 / half
            return poses, (focal / np.array(frame.scale)).mean(axis=1)
        extrinsics = self._output(answer, ("extrinsics",), (count, 3, 4)).astype(np.float64)
        matrices = self._output(answer, ("intrinsics",), (count, 3, 3)).astype(np.float64)
        u, _, vt = np.linalg.svd(extrinsics[:, :, :3])
        rotations = u @ vt
        if np.abs(rotations - extrinsics[:, :, :3]).max() > _ROTATION_TOLERANCE or (np.linalg.det(rotations) < 0).any():
            raise NumericsError(f"{self.path.name} returned matrices that are not rotations", remedy=_REMEDY)
        return rigid(rotations, extrinsics[:, :, 3]), (matrices[:, [1, 0], [1, 0]] / np.array(frame.scale)).mean(axis=1)

    def _output(self, answer: Mapping[str, Any], names: Sequence[str], shape: tuple[int, ...]) -> F32:
        """Return an output by one of its names, without axes of length one that the shape does not have."""
        name = next(name for name in names if name in answer)
        value = np.asarray(answer[name])
        if value.size != int(np.prod(shape)) or [s for s in value.shape if s > 1] != [s for s in shape if s > 1]:
            raise NumericsError(
                f"{self.path.name} returned {name} {list(value.shape)}", allowed=str(list(shape)), remedy=_REMEDY
            )
        if not np.isfinite(value).all():
            raise NumericsError(f"{self.path.name} returned {name} that is not finite", remedy=_REMEDY)
        return value.reshape(shape).astype(np.float32, copy=False)


@dataclass(frozen=True)
class _Frame:
    """The place of a view in the model's image.

    Args:
        size: Of the view, height and width.
        inner: The size to which it is resized.
        total: Of the model's image; the view lies in its middle, with white around it as in training.
    """

    size: Size
    inner: Size
    total: Size

    @classmethod
    def of(cls, size: tuple[int, ...], rows: int | None, columns: int | None) -> "_Frame":
        """Fit a view into fixed sides, or choose multiples of the patch size for open ones."""
        height, width = size
        if rows is None and columns is None:
            shrink = LONGER_SIDE / max(height, width)
            inner = tuple(max(_PATCH, round(side * shrink / _PATCH) * _PATCH) for side in (height, width))
            return cls((height, width), (inner[0], inner[1]), (inner[0], inner[1]))
        total = (rows or LONGER_SIDE, columns or LONGER_SIDE)
        shrink = min(total[0] / height, total[1] / width)
        return cls((height, width), (max(1, round(height * shrink)), max(1, round(width * shrink))), total)

    @property
    def scale(self) -> tuple[float, float]:
        """Get the model's pixels per pixel of the view, along rows and columns of the matrix."""
        return self.inner[0] / self.size[0], self.inner[1] / self.size[1]

    @property
    def _corner(self) -> Size:
        return (self.total[0] - self.inner[0]) // 2, (self.total[1] - self.inner[1]) // 2

    def filled(self, view: F32) -> F32:
        """Resize a view, [H, W, C], into the model's image, [rows, columns, 3]."""
        shrinks = self.inner[0] < self.size[0]
        resized = cv2.resize(
            view, self.inner[::-1], interpolation=cv2.INTER_AREA if shrinks else cv2.INTER_CUBIC
        ).reshape(*self.inner, -1)
        image = np.ones((*self.total, 3), np.float32)
        top, left = self._corner
        image[top : top + self.inner[0], left : left + self.inner[1]] = np.clip(resized, 0, 1)
        return image

    def restored(self, maps: F32) -> F32:
        """Resize maps of the model's image, [N, rows, columns], to the size of the views."""
        top, left = self._corner
        inner = maps[:, top : top + self.inner[0], left : left + self.inner[1]]
        resized = [cv2.resize(one, self.size[::-1], interpolation=cv2.INTER_LINEAR) for one in inner]
        return np.stack(resized)
