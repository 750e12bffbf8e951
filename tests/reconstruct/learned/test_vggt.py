"""Models of VGGT's signature, and every way in which a file or its answer can be wrong."""

import numpy as np
import pytest
from onnx import TensorProto, numpy_helper

from gs2ci.core.errors import InputError, NumericsError
from gs2ci.reconstruct.learned.vggt import Vggt

IMAGES = [("images", ("s", 3, "h", "w"))]
OUT = [("pose_enc", ("s", 9)), ("depth", ("s", "h", "w", 1))]


@pytest.fixture(scope="module")
def scene(seen):
    return seen()


def check(prediction, scene, count=5):
    np.testing.assert_allclose(prediction.world_to_camera, scene.poses, atol=1e-6)
    np.testing.assert_allclose(prediction.focal_px, 100, rtol=2e-3)  # a view's sides are rounded to pixels
    assert prediction.depth.shape == (count, 90, 120)
    assert np.median(np.abs(prediction.depth[2] * scene.inverse_depth - 1)) < 1e-3


@pytest.mark.parametrize("variety", [{}, {"matrices": True}, {"batch": True}, {"views": 5}, {"side": 21}])
def test_what_the_model_says_arrives_whatever_its_signature(make_vggt, scene, variety):
    """Of sides that are multiples of 14 the views fill all; of 21 they leave a rim."""
    check(Vggt(make_vggt(scene, **variety)).predict(scene.views, range(5)), scene)


@pytest.mark.parametrize("order", [(4, 3, 2, 1, 0), (2, 3, 4, 0, 1), (0, 2, 4, 1, 3)])
def test_the_answer_is_in_the_order_of_exposure_whatever_was_shown_first(make_vggt, scene, order):
    check(Vggt(make_vggt(scene)).predict(scene.views, order), scene)


def test_mono_views_are_shown_as_grey(make_vggt, seen):
    mono = seen(channels=1)
    check(Vggt(make_vggt(mono)).predict(mono.views, range(5)), mono)


def model_of(write_model, pose, depth=1.0, **more):
    """A model with open sides that says the same of every view."""
    constants = [
        numpy_helper.from_array(np.asarray(pose, np.float32)[None], "pose"),
        numpy_helper.from_array(np.float32(depth), "depth_of"),
        numpy_helper.from_array(np.float32(0), "nothing"),
    ]
    nodes = [
        ("ReduceMean", ["images"], ["grey"], {"axes": [1], "keepdims": 0}),
        ("Mul", ["grey", "nothing"], ["blank"]),
        ("Add", ["blank", "depth_of"], ["depth"]),
        ("ReduceMean", ["blank"], ["number"], {"axes": [1, 2], "keepdims": 0}),
        ("Unsqueeze", ["number", "last"], ["column"]),
        ("Add", ["column", "pose"], ["pose_enc"]),
    ]
    constants.append(numpy_helper.from_array(np.array([1], np.int64), "last"))
    return write_model(nodes, IMAGES, OUT, constants, **more)


LEVEL = [0.1, 0.2, 0.3, 0, 0, 0, 1, 0.8, 1.0]


@pytest.mark.parametrize("size", [(90, 120), (120, 90), (37, 300), (700, 1000)])
def test_open_sides_take_the_trained_width_and_give_back_the_views_size(write_model, size):
    views = np.full((3, *size, 3), 0.5, np.float32)
    prediction = Vggt(model_of(write_model, LEVEL, 2.0)).predict(views, range(3))
    np.testing.assert_allclose(prediction.depth, np.full((3, *size), 2.0), rtol=1e-6)
    wanted = np.mean([size[0] / 2 / np.tan(0.4), size[1] / 2 / np.tan(0.5)])
    np.testing.assert_allclose(prediction.focal_px, wanted, rtol=1e-5)
    np.testing.assert_allclose(prediction.world_to_camera[:, :3, 3], [[0.1, 0.2, 0.3]] * 3, atol=1e-6)


@pytest.mark.parametrize(
    ("pose", "depth", "problem"),
    [
        ([np.nan, *LEVEL[1:]], 1.0, "pose_enc that is not finite"),
        (LEVEL, np.inf, "depth that is not finite"),
        ([*LEVEL[:3], 0, 0, 0, 0, 1, 1], 1.0, "quaternion of length zero"),
    ],
)
def test_an_answer_that_is_no_camera_is_refused(write_model, scene, pose, depth, problem):
    with pytest.raises(NumericsError, match=problem):
        Vggt(model_of(write_model, pose, depth)).predict(scene.views, range(5))


def test_matrices_that_are_no_rotations_are_refused(make_vggt, scene):
    squeezed = scene.poses.copy()
    squeezed[1, :3, :3] *= 0.8
    with pytest.raises(NumericsError, match="not rotations"):
        Vggt(make_vggt(scene, poses=squeezed, matrices=True)).predict(scene.views, range(5))
    mirrored = scene.poses.copy()
    mirrored[1, :3, :3] = np.diag([1, 1, -1])
    with pytest.raises(NumericsError, match="not rotations"):
        Vggt(make_vggt(scene, poses=mirrored, matrices=True)).predict(scene.views, range(5))


def test_another_number_of_views_than_the_fixed_one_is_refused(make_vggt, scene):
    with pytest.raises(InputError, match="takes 5 views, not 4"):
        Vggt(make_vggt(scene, views=5)).predict(scene.views[:4], range(4))


def test_an_output_of_another_shape_is_refused(write_model, scene):
    model = write_model(
        [("ReduceMean", ["images"], ["depth"], {"axes": [1]}), ("ReduceMean", ["images"], ["pose_enc"], {"axes": [1]})],
        IMAGES,
        OUT,
    )
    with pytest.raises(NumericsError, match="returned pose_enc"):
        Vggt(model).predict(scene.views, range(5))


def test_a_model_that_fails_is_named(write_model, scene):
    constants = [numpy_helper.from_array(np.array([7, 7], np.int64), "seven")]
    model = write_model(
        [("Reshape", ["images", "seven"], ["pose_enc"]), ("Identity", ["images"], ["depth"])], IMAGES, OUT, constants
    )
    with pytest.raises(NumericsError, match=r"small\.onnx failed on images"):
        Vggt(model).predict(scene.views, range(5))


@pytest.mark.parametrize(
    ("inputs", "outputs"),
    [
        ([("images", (3, "h", "w"))], OUT),
        ([("images", ("s", 3, "h", "w"), TensorProto.DOUBLE)], [(*one, TensorProto.DOUBLE) for one in OUT]),
        (IMAGES, [("pose_enc", ("s", 9)), ("sky", ("s", "h", "w", 1))]),
        (IMAGES, [("extrinsics", ("s", 3, 4)), ("depth", ("s", "h", "w", 1))]),
    ],
)
def test_other_signatures_are_no_vggt(write_model, inputs, outputs):
    nodes = [("Identity", ["images"], [name]) for name, *_ in outputs]
    with pytest.raises(InputError, match="is not a VGGT model: it takes images"):
        Vggt(write_model(nodes, inputs, outputs))


def test_a_missing_file_and_an_unknown_operator_set_are_named(tmp_path, write_model):
    with pytest.raises(InputError, match="no model file"):
        Vggt(tmp_path / "absent.onnx")
    with pytest.raises(InputError, match="cannot be loaded"):
        Vggt(model_of(write_model, LEVEL, opset=999))
