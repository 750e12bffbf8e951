"""Ray tracing of textured meshes: the nearest triangle that each ray meets, and its texture there.

For scenes that are not a sum of Gaussians. Here: the mesh and its rays. Not here: pixels (`gs2ci_sims.radiance`), the
construction of meshes (`gs2ci_sims.scenes.meshes`).
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from gs2ci.core.arrays import F32, F64
from gs2ci.core.cameras import in_camera
from gs2ci.core.errors import InputError
from gs2ci.core.kernels import EXACT, f64, f64_1, f64_2, f64_3, helper, i64, i64_1, i64_2, in_parts, kernel
from gs2ci_sims.rays.tiles import TILE, by_tile, sphere_bounds

# Triangles whose corners all lie deeper than this are bounded by their corners; scene units.
NEAR: Final = 1e-6
# A ray meets a triangle up to this distance outside, in barycentric coordinates: no cracks between neighbours.
EDGE: Final = 1e-9
# Tolerance of a unit vector's length.
UNIT: Final = 1e-6


@dataclass(frozen=True)
class Gloss:
    """Highlights of one distant light on smooth surfaces: Phong's lobe (Communications of the ACM 18 (1975)).

    Args:
        normals: Normals of the surface at the triangles' corners, interpolated between them, [F, 3, 3]; of either sign.
        shine: Radiance of the highlight at its peak, [F], at least 0.
        exponent: Exponent of the cosine between the mirrored line of sight and the light, at least 1.
        towards_light: Direction towards the light, world axes, of length 1, [3].

    Raises:
        InputError: Shapes disagree, or a number is out of range.
    """

    normals: F64
    shine: F64
    exponent: float
    towards_light: F64

    def __post_init__(self) -> None:
        count = len(self.shine)
        fits = self.normals.shape == (count, 3, 3) and self.towards_light.shape == (3,)
        numbers = (self.normals, self.shine, self.towards_light)
        if not fits or not all(np.isfinite(one).all() for one in numbers):
            raise InputError(
                f"highlights with normals {list(self.normals.shape)}, shine {list(self.shine.shape)}, light "
                f"{list(self.towards_light.shape)}",
                allowed="[F, 3, 3], [F] and [3], finite numbers",
            )
        length = float(np.linalg.norm(self.towards_light))
        if (self.shine < 0).any() or not 1 <= self.exponent < np.inf or abs(length - 1) > UNIT:
            raise InputError(
                f"highlights of shine down to {self.shine.min(initial=0):g}, exponent {self.exponent:g}, light of "
                f"length {length:g}",
                allowed="shine of 0 or more, an exponent of 1 or more, a light of length 1",
            )


@dataclass(frozen=True)
class TexturedMesh:
    """Triangles that emit their textures: shading is part of the textures, highlights can be added.

    Args:
        corners: Corners of the triangles, scene units, [F, 3, 3]; both sides are visible.
        uv: Texture coordinates of each corner, [F, 3, 2]: 0 to 1 from left to right and from top to bottom; beyond,
            the texture repeats.
        which: Index of each triangle's texture, [F].
        textures: Linear radiance at least 0, [h, w, 3] each.
        tints: Factors of the textures at the triangles' corners, interpolated between them, at least 0, [F, 3, 3]; None
            has none.
        gloss: Highlights that move over the surfaces with the camera; None has none.

    Raises:
        InputError: Shapes disagree, a number is not finite or negative, or a texture is missing.
    """

    corners: F64
    uv: F64
    which: NDArray[np.int64]
    textures: tuple[F32, ...]
    tints: F64 | None = None
    gloss: Gloss | None = None

    def __post_init__(self) -> None:
        count = len(self.corners)
        fits = self.corners.shape == (count, 3, 3) and self.uv.shape == (count, 3, 2) and self.which.shape == (count,)
        if not fits or not np.isfinite(self.corners).all() or not np.isfinite(self.uv).all():
            raise InputError(
                f"a mesh with corners {list(self.corners.shape)}, uv {list(self.uv.shape)}, {len(self.which)} textures",
                allowed="[F, 3, 3], [F, 3, 2] and [F], finite numbers",
            )
        tints = self.tints
        if tints is not None and (tints.shape != (count, 3, 3) or not (np.isfinite(tints) & (tints >= 0)).all()):
            raise InputError(
                f"tints of shape {list(tints.shape)} on {count} triangles", allowed="[F, 3, 3] of finite numbers >= 0"
            )
        if self.gloss is not None and len(self.gloss.shine) != count:
            raise InputError(f"highlights of {len(self.gloss.shine)} triangles on {count}", allowed="equal numbers")
        if count and not 0 <= self.which.min() <= self.which.max() < len(self.textures):
            raise InputError(
                f"triangles with textures {self.which.min()} to {self.which.max()}",
                allowed=f"0 to {len(self.textures) - 1}",
            )
        for texture in self.textures:
            if texture.ndim != 3 or texture.shape[2] != 3 or min(texture.shape) < 1 or not (texture >= 0).all():
                raise InputError(f"a texture of shape {list(texture.shape)}", allowed="[h, w, 3] of finite radiance")
            if not np.isfinite(texture).all():
                raise InputError("a texture with infinite radiance", allowed="finite numbers, 0 or more")

    @property
    def brightest(self) -> float:
        """Get the largest radiance of the mesh."""
        lobe = 0.0 if self.gloss is None else float(self.gloss.shine.max(initial=0))
        tint = 1.0 if self.tints is None else float(self.tints.max(initial=0))
        return tint * max((float(texture.max()) for texture in self.textures), default=0.0) + lobe


def trace_mesh(mesh: TexturedMesh, world_to_camera: F64, intrinsics: F64, size: tuple[int, int]) -> tuple[F64, F64]:
    """Trace the rays through the centres of pixels.

    Args:
        mesh: The scene.
        world_to_camera: [4, 4].
        intrinsics: [3, 3].
        size: Height and width, px.

    Returns:
        Radiance [H, W, 3], bilinear in the texture, and depth z [H, W]; black and infinite for rays that meet nothing.
    """
    corners = in_camera(mesh.corners, world_to_camera)
    begins, items = by_tile(_bounds(corners, intrinsics), size)
    shapes = np.array([texture.shape[:2] for texture in mesh.textures], dtype=np.int64).reshape(-1, 2)
    starts = np.concatenate([[0], np.cumsum(shapes.prod(axis=1))]).astype(np.int64)
    texels = np.concatenate([np.zeros((0, 3)), *(texture.reshape(-1, 3) for texture in mesh.textures)])
    radiance, depth = np.zeros((*size, 3)), np.full(size, np.inf)
    uv, camera = np.ascontiguousarray(mesh.uv, np.float64), np.ascontiguousarray(intrinsics, np.float64)
    tints = np.zeros((0, 3, 3)) if mesh.tints is None else np.ascontiguousarray(mesh.tints, np.float64)
    in_parts(
        *(_trace, len(begins) - 1),
        *(begins, items, np.ascontiguousarray(corners), uv, mesh.which, shapes, starts, texels, tints),
        *_gloss_from(mesh.gloss, world_to_camera[:3, :3]),
        *(camera, radiance, depth),
    )
    return radiance, depth


def _gloss_from(gloss: Gloss | None, rotation: F64) -> tuple[F64, F64, float, F64]:
    """Return normals, shine, exponent and light in a camera's axes; no normals if nothing is glossy."""
    if gloss is None:
        return np.zeros((0, 3, 3)), np.zeros(0), 1.0, np.zeros(3)
    normals = np.ascontiguousarray(gloss.normals @ rotation.T)
    return normals, gloss.shine, float(gloss.exponent), rotation @ gloss.towards_light


@helper(fastmath=EXACT)
def _highlight(
    normals: F64,
    shine: F64,
    face: int,
    shares: tuple[float, float, float],
    dx: float,
    dy: float,
    exponent: float,
    light: F64,
) -> float:
    """Return the highlight's radiance where a ray (dx, dy, 1) meets a triangle, interpolated between its corners."""
    if len(shine) == 0 or shine[face] == 0:
        return 0.0
    n0, n1, n2 = 0.0, 0.0, 0.0
    for corner in range(3):
        n0 += shares[corner] * normals[face, corner, 0]
        n1 += shares[corner] * normals[face, corner, 1]
        n2 += shares[corner] * normals[face, corner, 2]
    along = dx * n0 + dy * n1 + n2
    square = n0 * n0 + n1 * n1 + n2 * n2
    # Both sides are visible, but only the lit one has highlights.
    lit = (n0 * light[0] + n1 * light[1] + n2 * light[2]) * along < 0
    if not lit or square == 0:
        return 0.0
    twice = 2 * along / square
    m0, m1, m2 = dx - twice * n0, dy - twice * n1, 1 - twice * n2
    cosine = (m0 * light[0] + m1 * light[1] + m2 * light[2]) / np.sqrt(dx * dx + dy * dy + 1)
    return float(shine[face] * cosine**exponent) if cosine > 0 else 0.0


@helper(fastmath=EXACT)
def _tint(tints: F64, face: int, shares: tuple[float, float, float], channel: int) -> float:
    """Return the factor of the texture at a place in a triangle, 1 if there are none."""
    if len(tints) == 0:
        return 1.0
    first, second, third = tints[face, :, channel]
    return float(shares[0] * first + shares[1] * second + shares[2] * third)


def _bounds(corners: F64, intrinsics: F64) -> F64:
    """Return the bounds of triangles in the image, px, [F, 4]; a sphere's if a triangle reaches behind the camera."""
    middle = corners.mean(axis=1)
    radii = np.linalg.norm(corners - middle[:, None], axis=2).max(axis=1, initial=0.0)
    bounds = sphere_bounds(middle, radii, intrinsics)
    depth = corners[:, :, 2]
    front = np.asarray(np.all(depth > NEAR, axis=1))
    for axis in (0, 1):
        place = corners[:, :, axis] / np.where(front[:, None], depth, 1.0) * intrinsics[axis, axis]
        place += intrinsics[axis, 2]
        bounds[front, 2 * axis] = place[front].min(axis=1, initial=np.inf) - 1e-6
        bounds[front, 2 * axis + 1] = place[front].max(axis=1, initial=-np.inf) + 1e-6
    return bounds


@kernel(
    *(i64, i64, i64_1, i64_1, f64_3, f64_3, i64_1, i64_2, i64_1, f64_2, f64_3),
    *(f64_3, f64_1, f64, f64_1, f64_2, f64_3, f64_2),
    fastmath=EXACT,
)
def _trace(
    from_tile,
    to_tile,
    begins,
    items,
    corners,
    uv,
    which,
    shapes,
    starts,
    texels,
    tints,
    normals,
    shine,
    exponent,
    light,
    intrinsics,
    radiance,
    depth,
):
    """Find the nearest hit of each ray by the signed volumes of Moeller and Trumbore (J. Graphics Tools 2 (1997))."""
    height, width = depth.shape
    across = -(-width // TILE)
    for tile in range(from_tile, to_tile):
        for y in range(TILE * (tile // across), min(TILE * (tile // across + 1), height)):
            for x in range(TILE * (tile % across), min(TILE * (tile % across + 1), width)):
                dx = (x + 0.5 - intrinsics[0, 2]) / intrinsics[0, 0]
                dy = (y + 0.5 - intrinsics[1, 2]) / intrinsics[1, 1]
                nearest, face, second, third = np.inf, -1, 0.0, 0.0
                for at in range(begins[tile], begins[tile + 1]):
                    f = items[at]
                    a0, a1, a2 = corners[f, 0]
                    e0, e1, e2 = corners[f, 1, 0] - a0, corners[f, 1, 1] - a1, corners[f, 1, 2] - a2
                    g0, g1, g2 = corners[f, 2, 0] - a0, corners[f, 2, 1] - a1, corners[f, 2, 2] - a2
                    # p = d x g with d = (dx, dy, 1)
                    p0, p1, p2 = dy * g2 - g1, g0 - dx * g2, dx * g1 - dy * g0
                    volume = e0 * p0 + e1 * p1 + e2 * p2
                    if volume == 0:
                        continue
                    u = -(a0 * p0 + a1 * p1 + a2 * p2) / volume
                    if u < -EDGE or u > 1 + EDGE:
                        continue
                    # q = -a x e
                    q0, q1, q2 = a2 * e1 - a1 * e2, a0 * e2 - a2 * e0, a1 * e0 - a0 * e1
                    v = (dx * q0 + dy * q1 + q2) / volume
                    if v < -EDGE or u + v > 1 + EDGE:
                        continue
                    where = (g0 * q0 + g1 * q1 + g2 * q2) / volume
                    if 0 < where < nearest:
                        nearest, face, second, third = where, f, u, v
                if face < 0:
                    continue
                depth[y, x] = nearest
                first = 1 - second - third
                across_texture = first * uv[face, 0, 0] + second * uv[face, 1, 0] + third * uv[face, 2, 0]
                down_texture = first * uv[face, 0, 1] + second * uv[face, 1, 1] + third * uv[face, 2, 1]
                rows, columns = shapes[which[face]]
                s, t = across_texture * columns - 0.5, down_texture * rows - 0.5
                left, top = int(np.floor(s)), int(np.floor(t))
                s, t = s - left, t - top
                for corner in range(4):
                    i, j = corner // 2, corner % 2
                    share = (t if i else 1 - t) * (s if j else 1 - s)
                    texel = starts[which[face]] + ((top + i) % rows) * columns + (left + j) % columns
                    for channel in range(3):
                        radiance[y, x, channel] += share * texels[texel, channel]
                shares = (first, second, third)
                lobe = _highlight(normals, shine, face, shares, dx, dy, exponent, light)
                for channel in range(3):
                    radiance[y, x, channel] = radiance[y, x, channel] * _tint(tints, face, shares, channel) + lobe
