#!/usr/bin/env bash
# A good guess: netCDF4 reads the readings that it wrote; only a variable with a fill value, or not written to, has masked ones. Found: the default
# fill values are masked where nobody set one, in bytes unless fill_value=False, in 16 bits even then: 255 and 65535, a camera's saturated
# pixels, vanish from means. xarray and h5netcdf read them. set_auto_mask(False) helps. And numbers that a scale_factor packs into 16 bits come round
# instead of being cut or refused, in netCDF4 and xarray alike: 70 m in millimetres is 4.464 m.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check netCDF4==1.7.5.1.post1 h5netcdf==1.8.2 h5py==3.16.0 xarray==2026.9.0 numpy==2.4.6
cat > look.py <<'PY'
import h5netcdf
import netCDF4
import numpy as np
import xarray

counts = {"u2": np.array([1000, 2000, 65534, 65535], "u2"), "u1": np.array([10, 20, 254, 255], "u1")}
metres = np.array([0.5, 1.25, 65.5, 70.0])
with netCDF4.Dataset("frame.nc", "w") as file:
    file.createDimension("x", 4)
    file.createVariable("u1", "u1", ("x",))[:] = counts["u1"]
    file.createVariable("u2", "u2", ("x",), fill_value=False)[:] = counts["u2"]
    packed = file.createVariable("metres", "u2", ("x",), fill_value=0)
    packed.scale_factor = 0.001
    packed[:] = metres
xarray.Dataset({"metres": ("x", metres)}).to_netcdf(
    "by-xarray.nc", engine="h5netcdf", encoding={"metres": {"dtype": "uint16", "scale_factor": 0.001, "_FillValue": 0}}
)
with netCDF4.Dataset("frame.nc") as file:
    masked = {kind: file[kind][:] for kind in counts}
    back = file["metres"][:].tolist()
    file.set_auto_mask(False)
    whole = {kind: file[kind][:] for kind in counts}
with h5netcdf.File("frame.nc") as file:
    others = {kind: file[kind][:] for kind in counts}
with xarray.open_dataset("frame.nc", engine="h5netcdf") as file:
    by_xarray = {kind: file[kind].values for kind in counts}
with xarray.open_dataset("by-xarray.nc", engine="h5netcdf") as file:
    back_by_xarray = file["metres"].values.round(3).tolist()
print("netCDF4", netCDF4.__version__, "xarray", xarray.__version__)
for kind, values in counts.items():
    print(kind, "netCDF4", masked[kind].tolist(), "mean", masked[kind].mean(), "xarray", by_xarray[kind].tolist(), "mean", by_xarray[kind].mean())
print("metres", metres.tolist(), "netCDF4", back, "xarray", back_by_xarray)
assert all(np.array_equal(read[kind], values) for read in (whole, others, by_xarray) for kind, values in counts.items())
assert np.allclose([back[:3], back_by_xarray[:3]], metres[:3])
assert [masked[kind].tolist()[3] for kind in counts] == [None, None], "the behaviour has changed"
assert np.allclose([back[3], back_by_xarray[3]], 4.464), "the behaviour has changed"
PY
v/bin/python look.py
