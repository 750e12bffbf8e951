"""The code of docs/how-to.md runs, on a measurement and a log that it names."""

import re
from pathlib import Path

import numpy as np

import gs2ci
from gs2ci.core.cameras import camera_centres


def test_the_log_of_a_stage_becomes_poses_in_its_unit(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    rng = np.random.default_rng(0)
    masks = (rng.random((4, 24, 32)) < 0.5).astype(np.uint8)
    np.savez("measurement.npz", meas=masks.sum(axis=0) * 0.5, masks=masks)
    at_s = np.linspace(0, 0.05, 11)
    log = np.stack([at_s, 100 * at_s, 7 + 0 * at_s, 0 * at_s], axis=1)  # 100 mm/s to the right, at 7 mm of height
    np.savetxt("stage.csv", log, delimiter=",", header="s,x_mm,y_mm,z_mm")
    given = []
    monkeypatch.setattr(gs2ci, "reconstruct", given.append)
    (code,) = re.findall(r"```python\n(.*?)```", Path(__file__).parents[1].joinpath("docs/how-to.md").read_text(), re.S)
    exec(code, {})
    poses = given[0].check().telemetry_world_to_camera
    np.testing.assert_allclose(camera_centres(poses), [[1.25 + 0.5 * k, 7, 0] for k in range(4)], atol=1e-9)
    # A thing in front of the camera, above it and to its right: z of the stage points backwards, y upwards.
    seen = poses[0] @ [1.25 + 3, 7 + 2, -50, 1]
    np.testing.assert_allclose(seen[:3], [3, -2, 50], atol=1e-9)
