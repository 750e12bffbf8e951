"""The import command: its arguments, what it prints, what it writes, and that errors write nothing."""

import os
from pathlib import Path

import h5py
import numpy as np
import pytest
import tyro

from gs2ci.commands.import_ import run
from gs2ci.core.errors import InputError, StorageError
from gs2ci.core.records import Shot
from gs2ci.core.storage import CaptureHeader, ShotWriter, count_shots, read_shot
from tests.manifests import assert_manifest_fits


@pytest.fixture
def arrays():
    rng = np.random.default_rng(0)
    masks = (rng.random((4, 20, 24)) < 0.5).astype(np.uint8)
    views = rng.integers(0, 256, (4, 20, 24, 3), dtype=np.uint8)
    meas = np.einsum("nhw,nhwc->hwc", masks, views / 255.0).astype(np.float32)
    matrix = np.array([[30.0, 0, 12], [0, 30.0, 10], [0, 0, 1]])
    poses = np.tile(np.eye(4), (4, 1, 1))
    return {"meas": meas, "masks": masks, "truth": views, "K": matrix, "world_to_camera": poses}


def command(*words: object) -> Shot:
    return read_shot(tyro.cli(run, args=[str(word) for word in words]))


def test_the_usual_keys_need_no_flags_and_every_guess_is_printed(tmp_path, arrays, capsys):
    np.savez(tmp_path / "scene.npz", **arrays)
    shot = command(tmp_path / "scene.npz", "-o", tmp_path / "shot.h5")
    assert np.array_equal(shot.measurement, arrays["meas"])
    assert np.array_equal(shot.intrinsics, arrays["K"])
    assert (shot.name, shot.provenance["source"]) == ("scene", "scene.npz")
    printed = capsys.readouterr().out
    for guess in shot.provenance["guesses"]:
        assert guess in printed
    assert "'meas' (measurement), 'masks' (masks), 'truth' (truth)" in printed
    assert printed.endswith(
        f"1 shot in {tmp_path / 'shot.h5'}\nnext: gs2ci reconstruct {tmp_path / 'shot.h5'} -o run/\n"
    )
    assert_manifest_fits(tmp_path / "shot.h5")


def test_the_lens_is_given_as_opencv_lists_it(tmp_path, arrays, capsys):
    np.savez(tmp_path / "a.npz", **arrays)
    words = ["--distortion", -0.2, 0.03, 0.001, -0.002]
    shot = command(tmp_path / "a.npz", *words, "-o", tmp_path / "shot.h5")
    assert shot.distortion.tolist() == [-0.2, 0.03, 0.001, -0.002, 0]
    assert "lens: k1 -0.2, k2 0.03" in capsys.readouterr().out


def test_masks_and_everything_else_may_lie_in_files_of_their_own(tmp_path, arrays):
    for key, values in arrays.items():
        np.save(tmp_path / f"{key}.npy", values)
    others = ["--truth", tmp_path / "truth.npy", "--poses", tmp_path / "world_to_camera.npy"]
    camera = ["--intrinsics", tmp_path / "K.npy"]
    shot = command(tmp_path / "meas.npy", tmp_path / "masks.npy", *others, *camera, "-o", tmp_path / "shot.h5")
    assert np.array_equal(np.rint(shot.truth.views * 255), arrays["truth"])
    assert np.array_equal(shot.truth.world_to_camera, arrays["world_to_camera"])
    assert np.array_equal(shot.intrinsics, arrays["K"])


def test_the_log_of_a_stage_lies_beside_a_measurement(tmp_path, arrays, capsys):
    np.savez(tmp_path / "a.npz", meas=arrays["meas"], masks=arrays["masks"])
    (tmp_path / "stage.csv").write_text("time_s,x_mm\n0,10\n1,11\n2,12\n3,13\n")
    stage, turn = ["--stage", tmp_path / "stage.csv"], ["--stage-turn-error-deg", 0.5]
    out = ["-o", tmp_path / "shot.h5", "--overwrite"]
    shot = command(
        tmp_path / "a.npz", *stage, "--stage-axes", "up", "left", "ahead", "--stage-error", 0.01, *turn, *out
    )
    centres = np.linalg.inv(shot.telemetry_world_to_camera)[:, :3, 3]
    assert np.allclose(centres, np.outer([10, 11, 12, 13], [0, -1, 0]))
    assert shot.provenance["telemetry"] == {"position_error": 0.01, "turn_error_deg": 0.5}
    assert "up as x grows" in " ".join(capsys.readouterr().out.split())
    for words in (["--stage-error", 0.01], ["--stage-axes", "up", "left", "ahead"], turn):
        with pytest.raises(InputError, match="without --stage"):
            command(tmp_path / "a.npz", *words, *out)
    for option in ("--stage-error", "--stage-turn-error-deg"):
        with pytest.raises(InputError, match=f"{option} 0"):
            command(tmp_path / "a.npz", *stage, option, 0, *out)
    with pytest.raises(InputError, match="would replace a file that it is made from"):
        run(tmp_path / "a.npz", out=tmp_path / "stage.h5", stage=tmp_path / "stage.h5")


def test_the_camera_may_be_four_numbers_or_a_focal_length(tmp_path, arrays):
    np.savez(tmp_path / "a.npz", meas=arrays["meas"], masks=arrays["masks"])
    out = ["-o", tmp_path / "shot.h5", "--overwrite"]
    shot = command(tmp_path / "a.npz", *out, "--intrinsics", 31, 32, 11.5, 9.5)
    assert np.array_equal(shot.intrinsics, [[31, 0, 11.5], [0, 32, 9.5], [0, 0, 1]])
    shot = command(tmp_path / "a.npz", *out, "--focal-px", 40)
    assert np.array_equal(shot.intrinsics, [[40, 0, 12], [0, 40, 10], [0, 0, 1]])
    for words in (["1", "2", "3"], ["a", "b", "c", "d"]):
        with pytest.raises(InputError, match="fx fy cx cy"):
            command(tmp_path / "a.npz", *out, "--intrinsics", *words)


def test_options_reach_the_import(tmp_path, arrays):
    counts = arrays["meas"] * 200 + 10
    counts[0, 0, 0] = np.nan
    np.savez(tmp_path / "a.npz", raw=counts, code=arrays["masks"].transpose(1, 2, 0) * 50, truth=np.zeros(3))
    words = "--meas-key raw --mask-key code --truth-key none --mask-axis last --meas-layout rgb --mask-scale 100"
    words += " --scale 200 --offset 10 --saturation 500 --bad-pixels median --views 3 --reverse-masks"
    shot = command(tmp_path / "a.npz", *words.split(), "-o", tmp_path / "shot.h5")
    assert np.array_equal(shot.masks, arrays["masks"][2::-1] * np.float32(0.5))
    assert shot.measurement[5, 5, 0] == pytest.approx(arrays["meas"][5, 5, 0], abs=1e-5)
    assert shot.truth.views is None
    assert np.array_equal(shot.saturated[1:], (counts >= 500).any(axis=2)[1:])


def test_a_mosaic_is_stored_with_its_filter_array(tmp_path, arrays):
    np.savez(tmp_path / "a.npz", meas=arrays["meas"][..., 0], masks=arrays["masks"])
    assert command(tmp_path / "a.npz", "--cfa", "GBRG", "-o", tmp_path / "shot.h5").cfa == "GBRG"


def test_all_measurements_are_stored_or_the_one_that_was_asked_for(tmp_path, arrays):
    stack = np.stack([arrays["meas"], arrays["meas"] * np.float32(0.9)])
    np.savez(tmp_path / "a.npz", meas=stack, masks=arrays["masks"])
    path = run(tmp_path / "a.npz", out=tmp_path / "shot.h5")
    assert count_shots(path) == 2
    assert np.array_equal(read_shot(path, 1).measurement, stack[1])
    path = run(tmp_path / "a.npz", out=tmp_path / "shot.h5", index=1, overwrite=True)
    assert count_shots(path) == 1
    assert read_shot(path).provenance["measurement"] == 1
    for index in (2, -1):
        with pytest.raises(InputError, match=f"no measurement {index}; allowed: 0 to 1"):
            run(tmp_path / "a.npz", out=tmp_path / "shot.h5", index=index, overwrite=True)


def test_an_interrupted_capture_is_recovered(tmp_path, capsys):
    header = CaptureHeader(5, 1, np.ones((1, 4, 4), np.float32), np.ones(1, np.float32))
    with ShotWriter(tmp_path / "rig.h5", header) as writer:
        writer.append(np.full((4, 4), 7, np.uint16))
        writer.append(np.full((4, 4), 8, np.uint16))
    path = run(tmp_path / "rig.h5.partial", out=tmp_path / "saved.h5")
    assert read_shot(path, 1).measurement[0, 0, 0] == 8
    assert "2 finished rows of rig.h5.partial saved in" in capsys.readouterr().out
    assert (tmp_path / "rig.h5.partial").exists()


@pytest.mark.parametrize(
    "options",
    [{"index": 0}, {"masks": Path("m.npy")}, {"intrinsics": ("K.npy",)}, {"scale": 2.0}, {"distortion": (0.1,)}],
)
def test_options_that_an_interrupted_capture_cannot_heed_are_refused(tmp_path, options):
    with pytest.raises(InputError, match=r"options with .*rig\.h5\.partial.*allowed: -o and --overwrite"):
        run(tmp_path / "rig.h5.partial", out=tmp_path / "saved.h5", **options)
    assert list(tmp_path.iterdir()) == []


def test_a_contradiction_writes_nothing_and_keeps_the_old_file(tmp_path, arrays):
    np.savez(tmp_path / "good.npz", **arrays)
    np.savez(tmp_path / "bad.npz", **{**arrays, "masks": -arrays["masks"].astype(float)})
    out = run(tmp_path / "good.npz", out=tmp_path / "shot.h5")
    before = out.read_bytes()
    with pytest.raises(InputError, match=r"bad\.npz, key 'masks': masks are negative"):
        run(tmp_path / "bad.npz", out=out, overwrite=True)
    assert out.read_bytes() == before
    assert sorted(p.name for p in tmp_path.iterdir()) == ["bad.npz", "good.npz", "shot.h5", "shot.json"]


def test_a_finished_file_is_replaced_only_when_asked(tmp_path, arrays):
    """The shot that lies there may be a capture, which nobody can take again."""
    np.savez(tmp_path / "a.npz", **arrays)
    np.savez(tmp_path / "b.npz", **arrays)
    out = run(tmp_path / "a.npz", out=tmp_path / "shot.h5")
    before = out.read_bytes()
    with pytest.raises(StorageError, match=r"shot\.h5: already exists; what to do: .*--overwrite"):
        run(tmp_path / "b.npz", out=out)
    assert out.read_bytes() == before
    run(tmp_path / "b.npz", out=out, overwrite=True)
    assert read_shot(out).name == "b"
    with ShotWriter(tmp_path / "rig.h5", CaptureHeader(1, 1, np.ones((1, 4, 4), np.float32), np.ones(1, "f4"))) as rig:
        rig.append(np.full((4, 4), 7, np.uint16))
    run(tmp_path / "rig.h5.partial", out=out, overwrite=True)
    assert read_shot(out).size == (4, 4)


def test_what_is_imported_is_never_replaced(tmp_path, arrays):
    np.savez(tmp_path / "a.npz", **arrays)
    (tmp_path / "a.npz").rename(tmp_path / "data.h5")
    before = (tmp_path / "data.h5").read_bytes()
    with pytest.raises(InputError, match="would replace a file that it is made from"):
        run(tmp_path / "data.h5", out=tmp_path / "data.h5", overwrite=True)
    np.savez(tmp_path / "a.npz", **arrays)
    with pytest.raises(StorageError, match=r"ends in \.h5"):
        run(tmp_path / "a.npz", out=tmp_path / "a.npz", overwrite=True)
    assert (tmp_path / "data.h5").read_bytes() == before


@pytest.mark.parametrize(
    ("words", "problem"),
    [
        (["--views", 0], "--views 0"),
        (["--focal-px", "nan"], "--focal-px nan"),
        (["--mask-scale", 0], "--mask-scale 0"),
        (["--scale", -2], "--scale -2"),
        (["--offset", "inf"], "--offset inf"),
        (["--offset", "1e300"], "--offset 1e+300"),
        (["--scale", "1e-300"], "--scale 1e-300"),
        (["--saturation", -1], "--saturation -1"),
        (["--distortion", "0.1", "nan", 0, 0], "--distortion nan"),
    ],
)
def test_a_number_out_of_range_is_refused_by_its_option(tmp_path, words, problem):
    with pytest.raises(InputError) as caught:
        command(tmp_path / "a.npz", "-o", tmp_path / "shot.h5", *words)
    assert caught.value.problem == problem
    assert "finite number" in caught.value.allowed or "whole number" in caught.value.allowed


def test_a_file_whose_name_is_no_utf8_is_imported_under_a_name_that_can_be_read(tmp_path, arrays):
    path = tmp_path / os.fsdecode(b"me\xfcss.npz")
    np.savez(path, **arrays)
    shot = command(path, "-o", tmp_path / "shot.h5")
    assert np.array_equal(shot.measurement, arrays["meas"])
    with h5py.File(tmp_path / "shot.h5") as file:
        assert file.attrs["name"] == r"me\udcfcss"
    assert_manifest_fits(tmp_path / "shot.h5")
