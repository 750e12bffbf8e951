#!/usr/bin/env bash
# A good guess: Mitsuba's ellipsoids find the properties of a splat's PLY file by their names, as the format means it and other readers do.
# Found: they are taken by their order. A file without normals, with opacity last or with one more property at the end is refused as "invalid
# structure"; one more property before opacity is no error, but is taken for a coefficient of harmonics, of which there are four numbers then.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check mitsuba==3.9.0 drjit==1.4.0 numpy==2.4.6
v/bin/python - <<'PY' | grep -v '@\|^\]\|el.struct'
import mitsuba as mi
import numpy as np

mi.set_variant("scalar_rgb")
usual = {"x": 1, "y": 2, "z": 3, "nx": 0, "ny": 0, "nz": 0, "f_dc_0": 1, "f_dc_1": -1, "f_dc_2": 0.3, "opacity": 2}
usual |= {"scale_0": -1, "scale_1": -2, "scale_2": -3, "rot_0": 0.8, "rot_1": 0.6, "rot_2": 0, "rot_3": 0}


def coefficients(names):
    head = ["ply", "format binary_little_endian 1.0", "element vertex 1", *(f"property float {name}" for name in names), "end_header\n"]
    with open("splat.ply", "wb") as file:
        file.write("\n".join(head).encode() + np.array([usual.get(name, 7) for name in names], "<f4").tobytes())
    try:
        return np.array(mi.traverse(mi.load_dict({"type": "ellipsoids", "filename": "splat.ply"}))["sh_coeffs"]).ravel().size
    except RuntimeError as error:
        return "invalid structure" if "Invalid structure" in str(error) else str(error)


names = list(usual)
found = {
    "usual": coefficients(names),
    "without normals": coefficients([name for name in names if not name.startswith("n")]),
    "opacity last": coefficients([name for name in names if name != "opacity"] + ["opacity"]),
    "one more at the end": coefficients([*names, "class"]),
    "one more before opacity": coefficients([*names[:9], "class", *names[9:]]),
}
print("Mitsuba", mi.__version__, "numbers that it takes for colours and harmonics:", found)
refused = "invalid structure"
assert list(found.values()) == [3, refused, refused, refused, 4], "the behaviour has changed"
PY
