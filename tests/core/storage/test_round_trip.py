"""What is written is what is read, bit for bit."""

import tempfile
from dataclasses import fields
from pathlib import Path

import h5py
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst

from gs2ci.core.records import CFA_PATTERNS, Shot, Truth
from gs2ci.core.storage import count_shots, read_shot, write_shots
from tests.manifests import assert_manifest_fits


def assert_same(a: Shot, b: Shot) -> None:
    for field in fields(Shot):
        x, y = getattr(a, field.name), getattr(b, field.name)
        parts = [(x.views, y.views), (x.world_to_camera, y.world_to_camera)] if field.name == "truth" else [(x, y)]
        for left, right in parts:
            if isinstance(left, np.ndarray):
                assert left.dtype == right.dtype, field.name
                assert np.array_equal(left, right), field.name
            else:
                assert left == right, field.name


JSON = st.recursive(
    st.none() | st.booleans() | st.integers(-(2**40), 2**40) | st.text(max_size=9),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner, max_size=3),
    max_leaves=6,
)


def floats(shape, low=None, high=None, dtype=np.float32):
    elements = st.floats(low, high, width=32, allow_nan=False, allow_infinity=False)
    return npst.arrays(dtype, shape, elements=elements)


@st.composite
def shots(draw):
    n, h, w = draw(st.integers(1, 3)), draw(st.integers(1, 5)), draw(st.integers(1, 5))
    channels = draw(st.sampled_from([1, 3]))
    cfa = draw(st.sampled_from([None, *CFA_PATTERNS])) if channels == 1 else None
    masks = draw(
        st.sampled_from(["binary", "bytes", "grey"]).flatmap(
            lambda kind: (
                floats((n, h, w), 0, 1)
                if kind == "grey"
                else npst.arrays(np.uint8, (n, h, w), elements=st.integers(0, 1 if kind == "binary" else 255)).map(
                    lambda a: a.astype(np.float32) / np.float32(1 if kind == "binary" else 255)
                )
            )
        )
    )
    masks[0, 0, 0] = 1
    weights = draw(floats((n,), 0, 2))
    weights[0] = 1
    poses = floats((n, 4, 4), -100, 100, np.float64)
    views = floats((n, h, w, 3 if cfa else channels), 0, 2)
    intrinsics = draw(st.none() | st.just(np.array([[30.5, 0, 2], [0, 31.25, 2], [0, 0, 1]])))
    lens = st.none() | st.just(np.array([-0.1, 0.02, 1e-3, -1e-3, 0.005]))
    return Shot(
        measurement=draw(floats((h, w, channels), -(2.0**39), 2.0**39)),
        masks=masks,
        weights=weights,
        cfa=cfa,
        intrinsics=intrinsics,
        distortion=None if intrinsics is None else draw(lens),
        truth=Truth(draw(st.none() | views), draw(st.none() | poses)),
        telemetry_world_to_camera=draw(st.none() | poses),
        saturated=draw(st.none() | npst.arrays(np.bool_, (h, w))),
        name=draw(st.text(st.characters(exclude_categories=["Cs"], exclude_characters="\0"), max_size=12)),
        provenance=draw(st.dictionaries(st.text(max_size=5), JSON, max_size=3)),
    )


@settings(max_examples=60, deadline=None)
@given(shots())
def test_any_shot_comes_back_bit_for_bit(shot):
    with tempfile.TemporaryDirectory() as folder:
        path = write_shots(Path(folder) / "shot.h5", [shot])
        assert_same(read_shot(path), shot)
        assert_manifest_fits(path)


def test_several_shots_come_back_in_their_order_with_their_own_truth(tmp_path, make_shot):
    first = make_shot()
    others = [
        make_shot(measurement=first.measurement * 2, truth=Truth(), name="second"),
        make_shot(measurement=first.measurement * 3, saturated=first.measurement[..., 0] > 1),
    ]
    path = write_shots(tmp_path / "shot.h5", [first, *others], config="gap_tv: {}\n")
    assert count_shots(path) == 3
    for index, shot in enumerate([first, *others]):
        assert_same(read_shot(path, index), shot)


@pytest.mark.parametrize(("levels", "dtype", "full_scale"), [(1, "u1", 1), (255, "u1", 255), (1000, "f4", 1)])
def test_masks_take_one_byte_a_pixel_where_that_loses_nothing(tmp_path, make_shot, levels, dtype, full_scale):
    masks = np.rint(make_shot(seed=3).truth.views[..., 0] * levels).astype(np.float32) / np.float32(levels)
    path = write_shots(tmp_path / "shot.h5", [make_shot(masks=masks)])
    with h5py.File(path) as file:
        assert file["masks/calib"].dtype == dtype
        assert file["masks/calib"].attrs["full_scale"] == full_scale
    assert np.array_equal(read_shot(path).masks, masks)


def test_the_file_is_laid_out_as_its_schema_says(tmp_path, make_shot):
    path = write_shots(tmp_path / "shot.h5", [make_shot(cfa="GRBG", channels=1, truth=Truth())], config="a: 1")
    with h5py.File(path) as file:
        assert file.attrs["schema"] == "gs2ci.capture/1"
        assert {"created_utc", "run_uid", "software", "units"} <= set(file.attrs)
        assert file["complete"][()] == 1
        assert file["meas"].shape == (1, 12, 16)
        assert file["meas"].chunks == (1, 12, 16)
        assert file["meas_valid"][:].tolist() == [1]
        assert file["config"][()] == b"a: 1"
        assert len(file["config"].attrs["sha256"]) == 64
        assert file["camera/cfa"][()] == b"GRBG"
        assert file["calib/weights"].dtype == "f8"
        assert set(file["frames"]) == {"sequence", "t_kernel_ns", "t_host_ns", "flags", "trigger_index"}


def test_a_finished_file_is_replaced_whole_and_its_manifest_with_it(tmp_path, make_shot):
    path = write_shots(tmp_path / "shot.h5", [make_shot()])
    write_shots(path, [make_shot(seed=5)])
    assert read_shot(path).provenance == {"seed": 5}
    assert_manifest_fits(path)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["shot.h5", "shot.json"]
