"""A mesh of the surfaces that a run's depths show.

Here: `fuse`, the truncated signed distance of all depths on one lattice, and the marching cubes through its zero
(Curless and Levoy, "A volumetric method for building complex models from range images", SIGGRAPH 1996; scikit-image's
marching cubes after Lewiner); `write_mesh`. Not here: depth. A surface is closed where views see it from all around;
elsewhere the mesh ends with what is seen.
"""

import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_erosion, map_coordinates
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from skimage.measure import marching_cubes

from gs2ci.core.arrays import F32, F64
from gs2ci.core.errors import InputError
from gs2ci.core.whole_file import write_whole
from gs2ci.evaluate.points import Cameras, surface_points
from gs2ci.render.ply import ERROR_PROPERTY, named_columns, ply_bytes

VOXELS: Final = 160
VOXEL_RANGE: Final = (8, 512)
# Distances are integrated so many voxels either side of a surface: less leaves holes, more fills gaps between surfaces.
TRUNCATION_VOXELS: Final = 4.0
LEAST_CONFIDENCE: Final = 0.5
LEAST_SHARE: Final = 0.01
"""Of the largest piece's area: smaller pieces are mostly where single wrong depths agree."""
# This share of the points at each end of an axis is left out, so that single wrong depths do not stretch the lattice.
_LEFT_OUT: Final = 0.005
_AT_ONCE: Final = 1 << 20


@dataclass(frozen=True)
class SurfaceMesh:
    """Triangles; V vertices, F faces.

    Args:
        vertices: In the unit of the path, [V, 3] float32.
        faces: Indices of vertices, anticlockwise seen from outside, [F, 3] int32.
        colours: Full scale 1, [V, 3] float32.
    """

    vertices: F32
    faces: NDArray[np.int32]
    colours: F32


def fuse(
    depth: F32,
    views: F32,
    cameras: Cameras,
    confidence: F32 | None = None,
    *,
    voxels: int = VOXELS,
    least_share: float = LEAST_SHARE,
) -> SurfaceMesh:
    """Fuse depths into one mesh.

    Args:
        depth: [N, H, W], 0 where nothing is seen.
        views: Their colours, [N, H, W, C].
        cameras: Of the views.
        confidence: Of depth, [N, H, W]; what lies below `LEAST_CONFIDENCE` is not used. None uses all.
        voxels: Of the lattice's longest side.
        least_share: Pieces that do not hang together with the rest are left out where their area is less than this
            share of the largest piece's; 0 keeps all.

    Raises:
        InputError: No depth is reliable, or no surface lies in the lattice.
    """
    if not 0 <= least_share <= 1:
        raise InputError(f"--least-share {least_share}", allowed="0 to 1")
    least, most = VOXEL_RANGE
    if not least <= voxels <= most:
        raise InputError(f"--voxels {voxels}", allowed=f"{least} to {most}")
    reliable = depth > 0 if confidence is None else (depth > 0) & (confidence >= LEAST_CONFIDENCE)
    if not reliable.any():
        raise InputError(
            "no depth of this run is reliable",
            allowed=f"pixels whose depth_confidence.npy is {LEAST_CONFIDENCE:g} or more",
            remedy="reconstruct again with a camera that moves sideways",
        )
    low, size = _box(depth, reliable, cameras)
    step = float(size.max()) / (voxels - 1)
    margin = np.ceil(TRUNCATION_VOXELS) + 1
    shape = tuple(int(n) for n in np.ceil(size / step) + 1 + 2 * margin)
    origin = low - margin * step
    distance, weight, colour = _integrated(depth, reliable, views, cameras, shape, origin, step)
    known = weight > 0
    # A cube is used only if everything around it is known; the library checks only one of its corners.
    sure = binary_erosion(known, np.ones((3, 3, 3), bool))
    try:
        with warnings.catch_warnings():
            # scikit-image up to 0.26 sets the shapes of its arrays, of which NumPy 2.5 says that it will end.
            warnings.simplefilter("ignore", DeprecationWarning)
            vertices, faces, _, _ = marching_cubes(distance, 0.0, mask=sure, gradient_direction="descent")
    except (ValueError, RuntimeError) as error:
        raise InputError(
            "the depths of this run make no surface", remedy="give more --voxels, or look at points.ply"
        ) from error
    vertices, faces = without_crumbs(vertices, faces, least_share)
    shades = np.stack([map_coordinates(colour[..., k], vertices.T, order=1) for k in range(3)], axis=1)
    share = map_coordinates(known.astype(np.float32), vertices.T, order=1)
    colours = np.clip(shades / np.maximum(share, 1e-6)[:, None], 0, 1).astype(np.float32)
    return SurfaceMesh((origin + step * vertices).astype(np.float32), faces.astype(np.int32), colours)


def without_crumbs(vertices: Any, faces: Any, least_share: float) -> tuple[Any, Any]:
    """Leave out pieces of a mesh whose area is less than a share of the largest piece's.

    The faces of a piece share edges.

    Args:
        vertices: [V, 3].
        faces: Indices of vertices, [F, 3].
        least_share: The share.

    Returns:
        The vertices and faces that stay.
    """
    count = len(faces)
    edges = np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    _, edge = np.unique(edges, axis=0, return_inverse=True)
    # A graph of faces and their edges: pieces that meet in a corner alone are two.
    nodes = count + len(edges)
    graph = coo_matrix((np.ones(len(edges), bool), (np.repeat(np.arange(count), 3), count + edge)), (nodes, nodes))
    piece = connected_components(graph, directed=False)[1][:count]
    corners = vertices[faces]
    areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) / 2
    whole = np.bincount(piece, areas)
    kept = faces[(whole >= least_share * whole.max(initial=0))[piece]]
    used, renamed = np.unique(kept, return_inverse=True)
    return vertices[used], renamed.reshape(kept.shape)


def write_mesh(path: Path, mesh: SurfaceMesh, standard_errors: F32 | None = None) -> Path:
    """Write a mesh as binary little-endian PLY with a colour per vertex, and a standard error if any are given, [V].

    Raises:
        StorageError: The file cannot be written.
    """
    colours = np.rint(255 * mesh.colours).astype(np.uint8)
    vertices = {**named_columns("xyz", mesh.vertices), **named_columns(("red", "green", "blue"), colours)}
    if standard_errors is not None:
        vertices[ERROR_PROPERTY] = standard_errors
    return write_whole(path, ply_bytes(vertices, mesh.faces))


def _box(depth: F32, reliable: NDArray[np.bool_], cameras: Cameras) -> tuple[F64, F64]:
    """Return the corner and the size of a box round the reliable points."""
    points = surface_points(np.where(reliable, depth, 0), cameras)
    low, high = np.quantile(points, (_LEFT_OUT, 1 - _LEFT_OUT), axis=0)
    size = high - low
    return low, np.maximum(size, 1e-3 * max(float(size.max()), 1e-12))


def _integrated(
    depth: F32,
    reliable: NDArray[np.bool_],
    views: F32,
    cameras: Cameras,
    shape: tuple[int, ...],
    origin: F64,
    step: float,
) -> tuple[F32, F32, F32]:
    """Return the mean signed distance in truncation lengths, positive before surfaces; weights; mean colours."""
    count = int(np.prod(shape))
    distance, weight = np.zeros(count, np.float32), np.zeros(count, np.float32)
    colour = np.zeros((count, 3), np.float32)
    truncation = TRUNCATION_VOXELS * step
    for begin in range(0, count, _AT_ONCE):
        part = slice(begin, min(begin + _AT_ONCE, count))
        places = np.stack(np.unravel_index(np.arange(part.start, part.stop), shape), axis=1)
        points = origin + step * places
        for view in range(len(depth)):
            inside, ahead, pixels = cameras.seen(points, view, (depth.shape[1], depth.shape[2]))
            column, row = pixels[inside].astype(int).T
            there = reliable[view, row, column]
            gap = (depth[view, row, column] - ahead[inside]) / truncation
            there &= gap >= -1
            chosen = np.flatnonzero(inside)[there] + begin
            distance[chosen] += np.minimum(gap[there], 1).astype(np.float32)
            weight[chosen] += 1
            colour[chosen] += np.clip(views[view][row[there], column[there]], 0, 1)
    known = np.maximum(weight, 1)
    # Unknown space counts as lying behind the surfaces.
    distance = np.where(weight > 0, distance / known, -1).astype(np.float32)
    return (
        distance.reshape(shape),
        weight.reshape(shape),
        np.divide(colour, known[:, None], dtype=np.float32).reshape(*shape, 3),
    )
