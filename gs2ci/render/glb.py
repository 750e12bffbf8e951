"""Gaussian scenes as binary glTF with the extension KHR_gaussian_splatting, which Khronos has ratified.

Here: `write_glb`. Kernel `ellipse`, all attributes 32-bit floats: places, unit quaternions (x, y, z, w), sizes and
opacities as they are (not their logs and logits), and the coefficients of spherical harmonics; besides, a colour per
point, linear as glTF wants it, for programs that draw points since they do not know the extension. Colours are light or
those of a screen, and the file says which: `lin_rec709_display` or `srgb_rec709_display`. Axes are right, up, back.
glTF's unit is the metre: a known unit stands in the node's scale. Not here: motion, which the extension cannot store;
reading.
"""

import json
import struct
from pathlib import Path
from typing import Any, Final

import numpy as np
import torch

from gs2ci.core.arrays import F64
from gs2ci.core.errors import InputError
from gs2ci.core.foreign.curves import light_of_srgb
from gs2ci.core.whole_file import write_whole
from gs2ci.render.gaussians import HARMONICS, Gaussians
from gs2ci.render.half_turn import half_turned
from gs2ci.render.harmonics import SH_DC, degree_of

EXTENSION: Final = "KHR_gaussian_splatting"
_FLOAT, _USHORT = 5126, 5123
_POINTS, _ARRAY_BUFFER = 0, 34962
_KINDS: Final = {1: "SCALAR", 3: "VEC3", 4: "VEC4"}
_MAGIC, _JSON, _BIN = 0x46546C67, 0x4E4F534A, 0x004E4942
_BYTES_MOST: Final = 2**32 - 1


def write_glb(
    path: str | Path, gaussians: Gaussians, *, metres_per_unit: float | None = None, of_light: bool = False
) -> Path:
    """Write a scene as GLB; the file appears whole or not at all.

    Args:
        path: Of the file; an existing file is replaced.
        gaussians: The scene.
        metres_per_unit: Length of the scene's unit; None if it is not known, and then a unit counts as a metre.
        of_light: Whether colours are in proportion to light, so that a screen has to encode them; otherwise they are
            those of a screen already (sRGB).

    Returns:
        The path written.

    Raises:
        InputError: The Gaussians do not fit together or hold NaN, or a size leaves 32-bit floats.
        StorageError: The file cannot be written.
    """
    scene = half_turned(gaussians.check())
    sizes = scene.log_scales.exp().numpy()
    if not np.isfinite(sizes.astype(np.float32)).all() or (sizes.astype(np.float32) == 0).any():
        raise InputError(
            f"sizes from e^{float(scene.log_scales.min()):.3g} to e^{float(scene.log_scales.max()):.3g} units",
            allowed="in glTF sizes that 32-bit floats hold: e^-103 to e^88",
        )
    opacity = torch.sigmoid(scene.opacity_logits).numpy()
    columns: dict[str, F64] = {
        "POSITION": scene.means.numpy(),
        f"{EXTENSION}:ROTATION": scene.quaternions.numpy()[:, [1, 2, 3, 0]],
        f"{EXTENSION}:SCALE": sizes,
        f"{EXTENSION}:OPACITY": opacity[:, None],
        f"{EXTENSION}:SH_DEGREE_0_COEF_0": (scene.colours.numpy() - 0.5) / SH_DC,
        "COLOR_0": np.concatenate([_linear(scene.colours.numpy(), of_light=of_light), opacity[:, None]], axis=1),
    }
    for degree in range(1, degree_of(scene) + 1):
        assert scene.harmonics is not None  # its degree is above 0
        for order in range(HARMONICS[degree] - HARMONICS[degree - 1]):
            coefficient = scene.harmonics[:, HARMONICS[degree - 1] + order].numpy()
            columns[f"{EXTENSION}:SH_DEGREE_{degree}_COEF_{order}"] = coefficient
    told = {"kernel": "ellipse", "colorSpace": "lin_rec709_display" if of_light else "srgb_rec709_display"}
    return write_whole(path, _laid_out(columns, told, metres_per_unit))


def _linear(colours: F64, *, of_light: bool) -> F64:
    """Return the light of colours, within 0 ... 1; those of a screen are decoded."""
    value = np.clip(colours, 0, 1)
    return value if of_light else light_of_srgb(value)


def _laid_out(columns: dict[str, F64], told: dict[str, str], metres_per_unit: float | None) -> bytes:
    """Lay out the attributes, [G, 1, 3 or 4] each, and what is told of them, as one primitive of a GLB file.

    Raises:
        InputError: It becomes too large.
    """
    views: list[dict[str, Any]] = []
    accessors: list[dict[str, Any]] = []
    parts = []
    at = 0
    for name, values in columns.items():
        # A colour needs no more than 16 bits; every other attribute is a float.
        held = np.rint(65535 * values).astype("<u2") if name == "COLOR_0" else values.astype("<f4")
        views.append({"buffer": 0, "byteOffset": at, "byteLength": held.nbytes, "target": _ARRAY_BUFFER})
        accessor: dict[str, Any] = {"bufferView": len(views) - 1, "count": len(held), "type": _KINDS[held.shape[1]]}
        accessor |= {"componentType": _USHORT, "normalized": True} if name == "COLOR_0" else {"componentType": _FLOAT}
        if name == "POSITION" and len(held):
            accessor |= {"min": held.min(axis=0).tolist(), "max": held.max(axis=0).tolist()}
        accessors.append(accessor)
        parts.append(held.tobytes())
        at += held.nbytes
    node: dict[str, Any] = {"name": "scene"}
    if metres_per_unit is not None:
        node["scale"] = [metres_per_unit] * 3
    whole: dict[str, Any] = {"asset": {"version": "2.0", "generator": "gs2ci"}, "extensionsUsed": [EXTENSION]}
    whole |= {"scene": 0, "scenes": [{"nodes": [0]}], "nodes": [node]}
    if at:  # glTF knows no empty accessor: a scene without Gaussians is a node without a mesh
        primitive = {"mode": _POINTS, "attributes": {name: k for k, name in enumerate(columns)}}
        node["mesh"] = 0
        whole["meshes"] = [{"primitives": [{**primitive, "extensions": {EXTENSION: told}}]}]
        whole |= {"accessors": accessors, "bufferViews": views, "buffers": [{"byteLength": at}]}
    text = json.dumps(whole, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    chunks = [(text, _JSON)] + ([(b"".join(parts) + bytes(-at % 4), _BIN)] if at else [])
    length = 12 + sum(8 + len(chunk) for chunk, _ in chunks)
    if length > _BYTES_MOST:
        raise InputError(f"a GLB file of {length / 2**30:.1f} GiB", allowed="less than 4 GiB", remedy="write it as sog")
    head = struct.pack("<III", _MAGIC, 2, length)
    return head + b"".join(struct.pack("<II", len(chunk), kind) + chunk for chunk, kind in chunks)
