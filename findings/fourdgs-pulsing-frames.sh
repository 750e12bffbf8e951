#!/usr/bin/env bash
# A good guess: fourdgs's convert_ply_sequence, which makes one scene in continuous time of a splat file for each frame, has a still splat of opacity
# 0.998 in all frames at 0.998 all the time, and one that moves where frame k has it at k / fps. Found: each frame's splats fade in and out within
# their own slot: by the library's own state_at they are 0.998 in the middle of it, 0.47 a quarter from it and 0.05 at k / fps; at 30 a
# second the scene begins empty. What moves is there half a frame later than in its files. The page promises a continuous scene.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --no-compile --disable-pip-version-check fourdgs==0.6.0 numpy==2.4.6
OMP_NUM_THREADS=1 v/bin/python - <<'PY'
from importlib.metadata import version
from pathlib import Path

import numpy as np
from fourdgs.convert import convert_ply_sequence

names = "x y z f_dc_0 f_dc_1 f_dc_2 opacity scale_0 scale_1 scale_2 rot_0 rot_1 rot_2 rot_3".split()
folder = Path("frames")
folder.mkdir()
for frame in range(4):
    header = ["ply", "format ascii 1.0", "element vertex 2", *(f"property float {name}" for name in names), "end_header"]
    splats = ["0 0 0 0 0 0 6 -3 -3 -3 1 0 0 0", f"{0.1 * frame} 1 0 0 0 0 6 -3 -3 -3 1 0 0 0"]
    (folder / f"{frame:03d}.ply").write_text("\n".join([*header, *splats, ""]))
opacity, place, alive = {}, {}, {}
for fps in (10, 30):
    scene, _ = convert_ply_sequence(str(folder), fps=fps)
    for frame in (0, 1, 1.25, 1.5, 1.75, 2, 2.5, 3.5):
        # Off the boundary of two frames by a hundredth of one, where rounding decides which is shown.
        state = scene.state_at((frame + 0.01 * (frame == int(frame) > 0)) / fps)
        alive[fps, frame] = len(state["indices"])
        if alive[fps, frame]:
            opacity[fps, frame], place[fps, frame] = float(state["opacity"][0]), float(state["centers"][1, 0])
        print("fourdgs", version("fourdgs"), f"{fps} a second, at {frame:g} frames:", f"opacity {opacity[fps, frame]:.3f}, the moving splat at {place[fps, frame]:.3f}" if alive[fps, frame] else "nothing")
assert all(abs(opacity[fps, frame] - 0.998) < 1e-3 for fps in (10, 30) for frame in (1.5, 2.5, 3.5))
assert all(opacity[fps, frame] < 0.07 and abs(opacity[fps, frame + 0.25] - 0.47) < 0.01 for fps in (10, 30) for frame in (1,)), "opacity: the behaviour has changed"
assert alive[30, 0] == 0 and alive[30, 1] == 2, "the first frame: the behaviour has changed"
assert all(abs(place[fps, 2] - 0.151) < 2e-3 and abs(place[fps, 2.5] - 0.2) < 1e-6 for fps in (10, 30)), "places: the behaviour has changed"
PY
