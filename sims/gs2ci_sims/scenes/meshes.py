"""Scenes of textured triangles: procedural ones, and those of OBJ and GLB files.

Such a scene is not a sum of Gaussians: surfaces are sharp, opaque and flat, so that a fitted scene cannot equal it. The
true depth is that of the rays through the pixels' centres. Not here: the rays (`gs2ci_sims.rays.meshes`).
"""

from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Final

import numpy as np
import torch

from gs2ci.core.arrays import F32, F64, Rng
from gs2ci.core.errors import InputError
from gs2ci.core.foreign.curves import light_of_srgb
from gs2ci.render.gaussians import Gaussians
from gs2ci_sims.rays.meshes import Gloss, TexturedMesh, trace_mesh
from gs2ci_sims.scene import Scene
from gs2ci_sims.scenes.rectangles import Rectangle, box, grain, rotation
from gs2ci_sims.scenes.stage import SuggestedCamera, floor_y

# Texels per pixel of the camera at a surface's middle: textures are as fine as the camera resolves.
TEXELS_PER_PX: Final = 1.0
# Direction towards the light, and brightness of faces that are turned away from it.
SUN: Final = np.array([-0.4, -0.8, -0.5]) / np.linalg.norm([-0.4, -0.8, -0.5])
AMBIENT: Final = 0.45
# Strips and rings of a sphere.
SPHERE_STEPS: Final = 24
GLTF_SUFFIXES: Final = (".glb", ".gltf")


def scene_from_mesh(
    name: str, mesh: TexturedMesh, size: tuple[int, int], intrinsics: F64, world_to_camera: F64 | None = None
) -> Scene:
    """Make a scene of a mesh, with its true depth.

    Raises:
        InputError: Nothing of it is in front of the camera.
    """
    pose = np.eye(4) if world_to_camera is None else world_to_camera
    depth = trace_mesh(mesh, pose, intrinsics, size)[1]
    nothing = Gaussians(*(torch.zeros(0, *columns) for columns in ((3,), (3,), (4,), (), (3,))))
    return Scene(name, nothing, intrinsics, size, np.where(np.isfinite(depth), depth, np.nan), pose, mesh=mesh)


def blocks(
    rng: Rng,
    frame: SuggestedCamera,
    *,
    count: int = 6,
    balls: int = 3,
    backdrop: float = 6.0,
    shine: float = 0.0,
    exponent: float = 30.0,
    light: tuple[float, float, float] = (-0.4, -0.8, -0.5),
) -> Scene:
    """Place boxes and balls on a chequered floor in front of a wall.

    Args:
        rng: Generator of positions, sizes and textures.
        frame: The camera.
        count: Boxes.
        balls: Balls.
        backdrop: Depth of the wall.
        shine: Radiance of a highlight at its peak, on all surfaces; 0 has none.
        exponent: Exponent of its cosine; a higher one gives a smaller highlight.
        light: Direction towards its light, camera axes (right, down, ahead), of any length. The shading is part of the
            textures and has another light.

    Raises:
        InputError: A count is negative, the wall is not in front of the camera, or a highlight is out of range.
    """
    if not np.linalg.norm(light) > 0:
        raise InputError(f"a light from {light}", allowed="a direction")
    if count < 0 or balls < 0 or not 0 < backdrop < np.inf:
        raise InputError(
            f"{count} boxes and {balls} balls before a wall at {backdrop}", allowed="counts of 0 or more, depth above 0"
        )
    builder = MeshBuilder(rng, frame)
    wide, high = 2 * backdrop * frame.half
    down = floor_y(frame, backdrop)
    builder.rectangle(Rectangle(np.array([0, 0, backdrop]), np.array([wide, 0, 0]), np.array([0, high, 0])))
    near = 0.5 * down / frame.half[1]
    middle, half = 0.5 * (near + backdrop), 0.5 * (backdrop - near)
    builder.rectangle(
        Rectangle(np.array([0, down, middle]), np.array([wide, 0, 0]), np.array([0, 0, half])), tiles=backdrop / 10
    )
    for _ in range(count):
        edges = rng.uniform(0.06, 0.16, 3) * backdrop * frame.half.min()
        depth = rng.uniform(0.45, 0.85) * backdrop
        place = np.array([rng.uniform(-0.8, 0.8) * frame.half[0] * depth, down - edges[1], depth])
        for face in box(place, rotation(np.array([0, rng.uniform(-0.7, 0.7), 0])) * edges):
            builder.rectangle(face)
    for _ in range(balls):
        radius = rng.uniform(0.06, 0.14) * backdrop * frame.half.min()
        depth = rng.uniform(0.4, 0.8) * backdrop
        builder.ball(np.array([rng.uniform(-0.7, 0.7) * frame.half[0] * depth, down - radius, depth]), radius)
    towards = np.array(light) / np.linalg.norm(light)
    mesh = builder.mesh(shine, exponent, towards)
    return scene_from_mesh("blocks" if shine == 0 else "glossy", mesh, frame.size, frame.intrinsics)


class MeshBuilder:
    """Collects triangles and their textures.

    Args:
        rng: Generator of the textures.
        frame: The camera, for which textures are fine enough.
    """

    def __init__(self, rng: Rng, frame: SuggestedCamera) -> None:
        self._rng, self._frame = rng, frame
        self._corners: list[F64] = []
        self._uv: list[F64] = []
        self._normals: list[F64] = []
        self._textures: list[F32] = []
        self._which: list[int] = []

    def rectangle(self, face: Rectangle, tiles: float = 0.0) -> None:
        """Add a flat face; with tiles, chequered at this spacing."""
        u, v = face.half_u, face.half_v
        corners = face.centre + np.array([-u - v, u - v, u + v, v - u])
        uv = np.array([[0.0, 0], [1, 0], [1, 1], [0, 1]])
        lengths = 2 * np.array([np.linalg.norm(v), np.linalg.norm(u)])
        texture = self._texture(lengths, float(face.centre[2]))
        if tiles > 0:
            rows, columns = (np.arange(n) / n * length for n, length in zip(texture.shape[:2], lengths, strict=True))
            texture[(rows[:, None] // tiles + columns // tiles).astype(int) % 2 == 1] *= 0.4
        normal = np.cross(u, v)
        normal /= np.linalg.norm(normal)
        texture *= self._lit(normal, face.centre)
        self._add(corners[[[0, 1, 2], [0, 2, 3]]], uv[[[0, 1, 2], [0, 2, 3]]], np.tile(normal, (2, 3, 1)), texture)

    def ball(self, centre: F64, radius: float) -> None:
        """Add a sphere of flat facets, each shaded by its angle to the light."""
        texture = self._texture(np.array([np.pi, 2 * np.pi]) * radius, float(centre[2]))
        theta, phi = np.linspace(0, np.pi, SPHERE_STEPS + 1), np.linspace(0, 2 * np.pi, 2 * SPHERE_STEPS + 1)
        sin, cos = np.sin(theta)[:, None], np.cos(theta)[:, None]
        outward = np.stack([sin * np.cos(phi), -cos + 0 * phi, sin * np.sin(phi)], axis=-1)
        angle = (np.arange(texture.shape[0]) + 0.5) / texture.shape[0] * np.pi
        turn = (np.arange(texture.shape[1]) + 0.5) / texture.shape[1] * 2 * np.pi
        normals = np.stack(
            np.broadcast_arrays(
                np.sin(angle)[:, None] * np.cos(turn),
                -np.cos(angle)[:, None],
                np.sin(angle)[:, None] * np.sin(turn),
            ),
            axis=-1,
        )
        texture *= (AMBIENT + (1 - AMBIENT) * np.maximum(normals @ SUN, 0.0))[..., None]
        uv = np.stack(np.meshgrid(phi / (2 * np.pi), theta / np.pi), axis=-1)
        points = centre + radius * outward
        quads = [
            (slice(None, -1), slice(None, -1)),
            (slice(None, -1), slice(1, None)),
            (slice(1, None), slice(1, None)),
        ]
        last = (slice(1, None), slice(None, -1))
        for turned in (quads, [quads[0], quads[2], last]):
            corners, places = (
                np.stack([grid[at].reshape(-1, grid.shape[2]) for at in turned], axis=1) for grid in (points, uv)
            )
            self._add(corners, places, (corners - centre) / radius, texture)

    def mesh(self, shine: float = 0.0, exponent: float = 1.0, towards_light: F64 = SUN) -> TexturedMesh:
        """Return the whole mesh, with highlights if `shine` is positive."""
        which = np.repeat(np.array(self._which), [len(part) for part in self._corners])
        normals = np.concatenate(self._normals)
        gloss = None if shine == 0 else Gloss(normals, np.full(len(normals), shine), exponent, towards_light)
        corners, uv = np.concatenate(self._corners), np.concatenate(self._uv)
        return TexturedMesh(corners, uv, which, tuple(self._textures), gloss=gloss)

    def _texture(self, lengths: F64, depth: float) -> F64:
        """Make a grainy colour texture, as fine as the camera resolves at this depth."""
        texels = np.clip(TEXELS_PER_PX * self._frame.focal * lengths / depth, 4, 2048).astype(int)
        colour = self._rng.uniform(0.25, 0.85, 3)
        rows, columns = int(texels[0]), int(texels[1])
        return np.clip(colour * (1 + grain(self._rng, (rows, columns), float(self._rng.uniform(0.8, 1.6)))), 0.0, 1.0)

    def _lit(self, normal: F64, centre: F64) -> float:
        towards = normal if normal @ centre < 0 else -normal
        return AMBIENT + (1 - AMBIENT) * max(float(towards @ SUN), 0.0)

    def _add(self, corners: F64, uv: F64, normals: F64, texture: F64) -> None:
        self._corners.append(corners)
        self._uv.append(uv)
        self._normals.append(normals)
        self._textures.append(texture.astype(np.float32))
        self._which.append(len(self._textures) - 1)


def mesh_from_file(path: Path) -> TexturedMesh:
    """Read a mesh from an OBJ, GLB, PLY or STL file: base colours, from textures, materials, corners or faces.

    Colours in such files are for screens (sRGB) and are converted to linear radiance, without any lighting. In glTF
    only textures are; factors of materials and colours of corners are linear, and all three are multiplied (glTF 2.0,
    section 3.9.2). In OBJ files a texture replaces the material's colour. What has no colour at all is grey.
    Transparency is left out.

    Raises:
        InputError: trimesh is not installed, the file cannot be read, a file that it names (materials, a texture) is
            missing, or it holds no triangles.
    """
    if find_spec("trimesh") is None:
        raise InputError(f"the mesh file {path} without trimesh", remedy="pip install 'gs2ci[mesh]'")
    if not path.is_file():
        raise InputError(f"no file {path}", allowed="an OBJ, GLB, PLY or STL file")
    scene = _loaded(path)
    # Not `Scene.dump`, whose copies have no colours of corners beside a material.
    placed = [scene.graph[node] for node in sorted(scene.graph.nodes_geometry)]
    parts = [(scene.geometry[name], pose) for pose, name in placed]
    parts = [(part, pose) for part, pose in parts if len(getattr(part, "faces", ()))]
    if not parts:
        raise InputError(f"{path} holds no triangles", allowed="a surface")
    linear = path.suffix.lower() in GLTF_SUFFIXES
    return TexturedMesh(
        np.concatenate([(part.vertices @ pose[:3, :3].T + pose[:3, 3])[part.faces] for part, pose in parts]),
        np.concatenate([_texture_places(part) for part, _ in parts]),
        np.repeat(np.arange(len(parts)), [len(part.faces) for part, _ in parts]),
        tuple(_texture_of(part) for part, _ in parts),
        np.concatenate([_tints(part, linear) for part, _ in parts]),
    )


def _loaded(path: Path) -> Any:
    """Load a file by trimesh, which itself goes on without materials and textures that it does not find.

    Raises:
        InputError: As `mesh_from_file`.
    """
    trimesh = import_module("trimesh")
    beside = trimesh.resolvers.FilePathResolver(path)
    read, missing = beside.get, []

    def noted(name: str) -> bytes:
        try:
            found: bytes = read(name)
        except (OSError, ValueError):
            missing.append(name)
            raise
        return found

    beside.get = noted
    try:
        scene = trimesh.load_scene(path, resolver=beside)
    except Exception as error:  # whatever a parser of foreign files may raise
        raise InputError(f"{path} cannot be read as a mesh: {error}", allowed="OBJ, GLB, PLY or STL") from error
    if missing:
        raise InputError(
            f"{path} names {missing[0]}, which is not there",
            remedy="put it beside the mesh, or remove its line (mtllib, map_Kd) to render the mesh without it",
        )
    return scene


def _image_of(part: Any) -> Any:
    """Return the picture that is painted on a part, None if there is none."""
    visual = part.visual
    if getattr(visual, "uv", None) is None:
        return None
    return getattr(visual.material, "baseColorTexture", None) or getattr(visual.material, "image", None)


def _texture_places(part: Any) -> F64:
    """Return the texture coordinates of a part's corners, [F, 3, 2]; in files v points upwards."""
    if _image_of(part) is None:
        return np.zeros((len(part.faces), 3, 2))
    return np.asarray(part.visual.uv[part.faces] * [1, -1] + [0, 1], dtype=np.float64)


def _texture_of(part: Any) -> F32:
    """Return a part's texture, [h, w, 3]; white if it has none."""
    image = _image_of(part)
    if image is None:
        return np.ones((1, 1, 3), dtype=np.float32)
    if image.mode.startswith("I"):
        # A grey picture of 16 bits, which Pillow would clip at 255.
        grey = np.asarray(image, dtype=np.float64)[..., None] / 65535
        return light_of_srgb(np.repeat(grey, 3, axis=2)).astype(np.float32)
    return light_of_srgb(np.asarray(image.convert("RGB"), dtype=np.float64) / 255).astype(np.float32)


def _tints(part: Any, linear: bool) -> F64:
    """Return the colours of a part's corners, by which its texture is multiplied, [F, 3, 3].

    Args:
        part: A mesh of trimesh's.
        linear: Whether the file's colours are linear, textures aside.
    """
    visual, faces = part.visual, part.faces
    material = getattr(visual, "material", None)
    if material is None:
        by_face = visual.kind == "face"
        found = _coded(visual.face_colors)[:, None] if by_face else _coded(visual.vertex_colors)[faces]
        # What has no colours of its own has trimesh's grey, which is for screens in any file.
        tints = found if linear and visual.defined else light_of_srgb(found)
        return np.array(np.broadcast_to(tints, (len(faces), 3, 3)))
    if not linear:
        return np.ones((len(faces), 3, 3)) * (1.0 if _image_of(part) else light_of_srgb(_coded(material.main_color)))
    factor = getattr(material, "baseColorFactor", None)
    tints = np.ones((len(faces), 3, 3)) * (1.0 if factor is None else _coded(factor))
    corners = visual.vertex_attributes.get("color")
    return tints if corners is None else tints * _coded(corners)[faces]


def _coded(colours: Any) -> F64:
    """Return colours without their opacity, [..., 3] in [0, 1]; whole numbers reach up to their type's largest."""
    found = np.asarray(colours)
    full = np.iinfo(found.dtype).max if found.dtype.kind == "u" else 1.0
    return np.asarray(found[..., :3] / full, dtype=np.float64)
