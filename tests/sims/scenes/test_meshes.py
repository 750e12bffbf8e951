"""Scenes of triangles: procedural ones, files, and their way through an exposure."""

import json
import struct
from dataclasses import replace

import numpy as np
import pytest

from gs2ci.core.errors import InputError
from gs2ci_sims.effects.motion_blur import MotionBlur
from gs2ci_sims.effects.object_motion import ObjectMotion
from gs2ci_sims.effects.views import Defocus, LensDistortion
from gs2ci_sims.exact import ExactRenderer
from gs2ci_sims.exposure import integrate
from gs2ci_sims.light_path import EffectChain, sensor_effects
from gs2ci_sims.masks import random_masks
from gs2ci_sims.path import StageMove, stage_move_for_parallax
from gs2ci_sims.planner import plan
from gs2ci_sims.radiance import Renderer
from gs2ci_sims.rig import ModulatorFigures, RigFigures, Timing
from gs2ci_sims.scene import Scene
from gs2ci_sims.scenes import meshes
from gs2ci_sims.scenes.files import load_scene
from gs2ci_sims.scenes.meshes import blocks, mesh_from_file, scene_from_mesh
from gs2ci_sims.scenes.planes import planes
from gs2ci_sims.scenes.stage import SuggestedCamera
from gs2ci_sims.simulation_plan import PlanChoice, SimulationTask
from tests.exposing import expose
from tests.sims.brute_force import deviation_dn, simulate_everything

SIZE = (24, 32)
RIG = RigFigures(modulator=ModulatorFigures(masks=2), timing=Timing(0.02))
STILL = StageMove((0.0, 0.0, 0.0))


@pytest.fixture(scope="module")
def scene():
    return blocks(np.random.default_rng(5), SuggestedCamera(SIZE, 50.0))


def test_blocks_fill_the_frame_and_keep_their_seed(scene):
    again, other = (blocks(np.random.default_rng(seed), SuggestedCamera(SIZE, 50.0)) for seed in (5, 6))
    views = [Renderer().views(one, np.eye(4)[None]) for one in (scene, again, other)]
    assert views[0][1].min() == 1
    assert np.array_equal(views[0][0], views[1][0])
    assert np.abs(views[0][0] - views[2][0]).mean() > 0.01
    assert 0 < views[0][0].min() < views[0][0].max() <= scene.brightest <= 1
    near, far = scene.depth_range()
    assert far > 1.5 * near


def test_the_true_depth_is_that_which_either_renderer_gives(scene):
    for renderer in (Renderer(), ExactRenderer()):
        assert renderer.depth(scene, np.eye(4)) == pytest.approx(scene.depth)


def test_the_true_depth_of_an_exposure_to_a_mesh_is_that_of_its_rays_also_through_a_lens(scene):
    masks = random_masks(2, SIZE, 0.5, np.random.default_rng(0))
    plain, bent = (
        expose(scene, STILL, masks, RIG, effects=(MotionBlur(1), *lens), seed=0).truth.depth
        for lens in ((), (LensDistortion(-0.2),))
    )
    np.testing.assert_allclose(plain[0], scene.depth, rtol=1e-6)
    middle = np.s_[0, SIZE[0] // 2 - 1 : SIZE[0] // 2 + 1, SIZE[1] // 2 - 1 : SIZE[1] // 2 + 1]
    np.testing.assert_allclose(bent[middle], plain[middle], rtol=1e-6)  # a lens leaves its axis where it is
    assert (bent > 0).all()
    assert np.abs(bent - plain).max() > 0.05


def test_a_mesh_is_exposed_within_the_tolerance_of_its_plan(scene):
    masks = random_masks(2, SIZE, 0.5, np.random.default_rng(0))
    path = stage_move_for_parallax(scene, 1.0, RIG.exposure_s, wobble_deg=0.0)
    effects = (MotionBlur(), Defocus(0.02, 3.0))
    renderer = Renderer(4)
    decided = plan(SimulationTask(scene, path, masks, RIG, effects), PlanChoice(20.0), renderer=renderer)
    everything = simulate_everything(scene, path, masks, RIG, effects, seed=0, settle_dn=1.0, renderer=renderer)
    photons = integrate(scene, path, masks, EffectChain(decided.effects, 0, RIG), renderer=renderer)
    assert decided.error_dn <= 20.0
    assert deviation_dn(everything, photons, decided.effects, 0) <= decided.error_dn + 1.0


def test_a_shot_of_a_mesh_has_true_views_and_poses():
    loaded = load_scene("blocks", size=SIZE, parallax_px=2.0)
    masks = random_masks(2, SIZE, 0.1, np.random.default_rng(0))  # mostly closed: nothing may be skipped
    shot = expose(loaded.scene, loaded.path(RIG.exposure_s), masks, RIG, effects=sensor_effects(RIG.sensor), seed=0)
    assert np.isfinite(shot.measurement).all()
    assert np.abs(shot.truth.views[0] - shot.truth.views[1]).max() > 0.01


def test_objects_of_a_mesh_do_not_move(scene):
    with pytest.raises(InputError, match="without Gaussians"):
        expose(
            scene, STILL, np.ones((2, *SIZE), np.float32), RIG,
            effects=(ObjectMotion((0.0, 0.0, 3.0), 1.0, (1.0, 0.0, 0.0)),), seed=0,
        )  # fmt: skip


def test_a_scene_is_of_one_kind(scene):
    other = planes(np.random.default_rng(0), SIZE)
    with pytest.raises(InputError, match="one kind or the other"):
        Scene("both", other.gaussians, other.intrinsics, SIZE, other.depth, mesh=scene.mesh)


@pytest.mark.parametrize("options", [{"count": -1}, {"balls": -1}, {"backdrop": 0.0}])
def test_blocks_without_meaning_are_refused(options):
    with pytest.raises(InputError, match="boxes and"):
        blocks(np.random.default_rng(0), SuggestedCamera(SIZE, 50.0), **options)


OBJ = """mtllib quad.mtl
v -2 -2 3
v 2 -2 3
v 2 2 3
v -2 2 3
vt 0 1
vt 1 1
vt 1 0
vt 0 0
usemtl paint
f 1/1 2/2 3/3
f 1/1 3/3 4/4
"""


def test_an_obj_file_keeps_its_texture_the_right_way_up(tmp_path):
    image = pytest.importorskip("PIL.Image")
    pytest.importorskip("trimesh")
    pixels = np.zeros((2, 2, 3), np.uint8)
    pixels[0, 0], pixels[0, 1], pixels[1, 0] = [255, 0, 0], [0, 255, 0], [0, 0, 188]
    image.fromarray(np.kron(pixels, np.ones((8, 8, 1), np.uint8))).save(tmp_path / "paint.png")
    (tmp_path / "quad.mtl").write_text("newmtl paint\nmap_Kd paint.png\n")
    (tmp_path / "quad.obj").write_text(OBJ)
    intrinsics = np.array([[16.0, 0, 16], [0, 16, 12], [0, 0, 1]])
    view = Renderer().views(
        scene_from_mesh("quad", mesh_from_file(tmp_path / "quad.obj"), SIZE, intrinsics), np.eye(4)[None]
    )[0][0]
    # Image rows count downwards as y does here, and v = 1 is the top of the picture.
    assert view[6, 10] == pytest.approx([1, 0, 0], abs=1e-6)
    assert view[6, 22] == pytest.approx([0, 1, 0], abs=1e-6)
    assert view[18, 10] == pytest.approx([0, 0, 0.5], abs=0.01)  # sRGB 188 is half of the light
    (tmp_path / "scene.toml").write_text('name = "quad"\n[geometry]\nkind = "mesh"\nfile = "quad.obj"\n')
    assert len(load_scene(tmp_path / "scene.toml", size=SIZE).scene.mesh.corners) == 2


# In glTF colours of corners are linear (glTF 2.0, section 3.9.2), in other files they are for screens.
@pytest.mark.parametrize(("name", "green"), [("ball.glb", 188 / 255), ("ball.ply", 0.503)])
def test_coloured_corners_are_read_in_the_units_of_their_format(tmp_path, name, green):
    trimesh = pytest.importorskip("trimesh")
    ball = trimesh.creation.icosphere(subdivisions=2, radius=1.0)
    ball.apply_translation([0, 0, 3])
    ball.visual.vertex_colors = np.tile([255, 188, 0, 255], (len(ball.vertices), 1))
    ball.export(tmp_path / name)
    scene = scene_from_mesh("ball", mesh_from_file(tmp_path / name), SIZE, SuggestedCamera(SIZE, 50.0).intrinsics)
    view = Renderer().views(scene, np.eye(4)[None])[0][0]
    assert view[12, 16] == pytest.approx([1.0, green, 0.0], abs=0.001)
    assert scene.depth[12, 16] == pytest.approx(2.0, abs=0.02)
    assert np.isnan(scene.depth[0, 0])


QUAD = np.array([[-2.0, -2, 3], [2, -2, 3], [2, 2, 3], [-2, 2, 3]])
HALVES = np.array([[0, 1, 2], [0, 2, 3]])
CORNERS_UV = np.array([[0.0, 1], [1, 1], [1, 0], [0, 0]])
QUAD_CAMERA = np.array([[16.0, 0, 16], [0, 16, 12], [0, 0, 1]])


def view_of(path):
    scene = scene_from_mesh("quad", mesh_from_file(path), SIZE, QUAD_CAMERA)
    return Renderer().views(scene, np.eye(4)[None])[0][0]


def test_a_glb_multiplies_texture_and_linear_factor(tmp_path):
    image, trimesh = pytest.importorskip("PIL.Image"), pytest.importorskip("trimesh")
    grey = image.fromarray(np.full((4, 4, 3), 188, np.uint8))  # half of the light
    material = trimesh.visual.material.PBRMaterial(baseColorFactor=[51, 102, 255, 255], baseColorTexture=grey)
    visual = trimesh.visual.TextureVisuals(uv=CORNERS_UV, material=material)
    trimesh.Trimesh(QUAD, HALVES, visual=visual, process=False).export(tmp_path / "quad.glb")
    assert view_of(tmp_path / "quad.glb")[12, 16] == pytest.approx(0.503 * np.array([0.2, 0.4, 1.0]), abs=1e-3)


@pytest.mark.parametrize("kind", ["<f4", "<u2"])
def test_a_glb_multiplies_factor_and_colours_of_corners(tmp_path, kind):
    """Written by hand, since trimesh writes no colours of corners beside a material."""
    pytest.importorskip("trimesh")
    full = 1 if kind == "<f4" else 65535
    arrays = [QUAD.astype("<f4"), HALVES.astype("<u2").ravel(), np.tile([0.5 * full, full, full, full], (4, 1))]
    data = [array.tobytes() for array in (*arrays[:2], arrays[2].astype(kind))]
    starts = np.cumsum([0, *(len(one) for one in data)]).tolist()
    views = [
        {"buffer": 0, "byteOffset": start, "byteLength": len(one)} for start, one in zip(starts, data, strict=False)
    ]
    colour = {"componentType": 5126} if kind == "<f4" else {"componentType": 5123, "normalized": True}
    gltf = {
        "asset": {"version": "2.0"},
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, "translation": [0, 0, 1]}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0, "COLOR_0": 2}, "indices": 1, "material": 0}]}],
        "materials": [{"pbrMetallicRoughness": {"baseColorFactor": [0.6, 0.2, 1, 1]}}],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": 4, "type": "VEC3", "min": [-2, -2, 3], "max": [2, 2, 3]},
            {"bufferView": 1, "componentType": 5123, "count": 6, "type": "SCALAR"},
            {"bufferView": 2, "count": 4, "type": "VEC4", **colour},
        ],
        "bufferViews": views,
        "buffers": [{"byteLength": starts[-1]}],
    }
    text = json.dumps(gltf).encode()
    chunks = [(b"JSON", text + b" " * (-len(text) % 4)), (b"BIN\0", b"".join(data) + bytes(-starts[-1] % 4))]
    body = b"".join(struct.pack("<I4s", len(chunk), name) + chunk for name, chunk in chunks)
    (tmp_path / "quad.glb").write_bytes(struct.pack("<4sII", b"glTF", 2, 12 + len(body)) + body)
    assert view_of(tmp_path / "quad.glb")[12, 16] == pytest.approx([0.3, 0.2, 1.0], abs=1e-4)
    assert mesh_from_file(tmp_path / "quad.glb").corners[..., 2] == pytest.approx(4.0)  # where its node puts it


def test_materials_without_texture_coordinates_colour_their_triangles(tmp_path):
    pytest.importorskip("trimesh")
    (tmp_path / "two.mtl").write_text("newmtl red\nKd 1 0 0\nnewmtl blue\nKd 0 0 0.5\n")
    corners = "\n".join(line for line in OBJ.splitlines() if line.startswith("v "))
    (tmp_path / "two.obj").write_text(f"mtllib two.mtl\n{corners}\nusemtl red\nf 1 2 3\nusemtl blue\nf 1 3 4\n")
    view = view_of(tmp_path / "two.obj")
    assert view[6, 22] == pytest.approx([1, 0, 0])
    assert view[18, 10] == pytest.approx([0, 0, 0.214], abs=0.003)  # sRGB 0.5


def test_colours_of_faces_end_at_their_edges_and_those_of_corners_run_evenly_in_light(tmp_path):
    trimesh = pytest.importorskip("trimesh")
    faces = trimesh.Trimesh(QUAD, HALVES, face_colors=[[255, 0, 0, 255], [0, 0, 255, 255]], process=False)
    faces.export(tmp_path / "faces.ply")
    view = view_of(tmp_path / "faces.ply")
    assert view[6, 22] == pytest.approx([1, 0, 0])
    assert view[18, 10] == pytest.approx([0, 0, 1])
    ends = np.array([[0, 0, 0, 255], [255, 255, 255, 255], [255, 255, 255, 255], [0, 0, 0, 255]], np.uint8)
    trimesh.Trimesh(QUAD, HALVES, vertex_colors=ends, process=False).export(tmp_path / "corners.ply")
    row = view_of(tmp_path / "corners.ply")[12, 6:26, 0]
    places = 3 * (np.arange(6, 26) + 0.5 - 16) / 16
    assert row == pytest.approx((places + 2) / 4, abs=1e-6)


def test_a_grey_texture_of_sixteen_bits_keeps_its_greys(tmp_path):
    image = pytest.importorskip("PIL.Image")
    pytest.importorskip("trimesh")
    image.fromarray(np.full((4, 4), 188 * 257, np.uint16)).save(tmp_path / "paint.png")
    (tmp_path / "quad.mtl").write_text("newmtl paint\nmap_Kd paint.png\n")
    (tmp_path / "quad.obj").write_text(OBJ)
    assert view_of(tmp_path / "quad.obj")[12, 16] == pytest.approx([0.503] * 3, abs=1e-3)


@pytest.mark.parametrize("material", ["", "newmtl paint\nmap_Kd paint.png\n"], ids=["materials", "texture"])
def test_a_mesh_without_the_materials_or_the_texture_that_it_names_is_refused(tmp_path, material):
    """The reader of meshes goes on without them, and the mesh would be grey."""
    pytest.importorskip("trimesh")
    (tmp_path / "quad.obj").write_text(OBJ)
    if material:
        (tmp_path / "quad.mtl").write_text(material)
    missing = "paint.png" if material else "quad.mtl"
    with pytest.raises(InputError, match=f"names {missing}, which is not there") as caught:
        mesh_from_file(tmp_path / "quad.obj")
    assert "put it beside the mesh" in caught.value.remedy
    (tmp_path / "quad.obj").write_text(OBJ.replace("mtllib quad.mtl", ""))
    assert len(mesh_from_file(tmp_path / "quad.obj").corners) == 2


def test_files_that_hold_no_mesh_are_refused(tmp_path, monkeypatch):
    pytest.importorskip("trimesh")
    (tmp_path / "points.obj").write_text("v 0 0 1\n")
    (tmp_path / "noise.glb").write_bytes(b"nothing")
    for name, words in (("none.obj", "no file"), ("points.obj", "triangles|cannot"), ("noise.glb", "cannot be read")):
        with pytest.raises(InputError, match=words):
            mesh_from_file(tmp_path / name)
    monkeypatch.setattr(meshes, "find_spec", lambda _name: None)
    with pytest.raises(InputError, match="without trimesh"):
        mesh_from_file(tmp_path / "points.obj")


def test_highlights_come_on_top_and_move_with_the_camera():
    glossy = load_scene("glossy", size=SIZE)
    dull = replace(glossy.scene, mesh=replace(glossy.scene.mesh, gloss=None))
    poses = glossy.path(1.0).world_to_camera(np.array([0.0, 1.0]))
    shine = Renderer().views(glossy.scene, poses)[0] - Renderer().views(dull, poses)[0]
    assert shine.min() > -1e-6
    assert 0.02 < (shine > 0.05).mean() < 0.5
    assert np.ptp(shine, axis=3).max() < 1e-6  # white light


def test_a_light_from_nowhere_is_refused():
    with pytest.raises(InputError, match="a light from"):
        blocks(np.random.default_rng(0), SuggestedCamera(SIZE, 50.0), light=(0.0, 0.0, 0.0))
