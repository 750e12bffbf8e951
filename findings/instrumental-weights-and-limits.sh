#!/usr/bin/env bash
# A good guess: curve_fit() of instrumental, a wrapper of SciPy's for quantities with units, weights points by sigma; its status of a Thorlabs
# TDC001 says which flags are set; and get_jog_params() of the driver by serial line gives mm/s and mm/s^2. Found: sigma is dropped as soon as
# anything has a unit; of one set flag all above it are taken as set, too: a touched limit switch is both, and the motor moves, jogs,
# homes, has homed and is enabled, since a flag is any remainder that is not 0; and velocity and acceleration of jogs exchange their factors: 1 mm/s^2 is 0.00034.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v
v/bin/pip install --quiet --no-compile --disable-pip-version-check Instrumental-lib==0.8 numpy==2.4.6 scipy==1.17.1 pint==0.25.3 matplotlib==3.10.8 pyserial==3.5 pyvisa==1.16.2 setuptools==80.9.0
v/bin/python - <<'PY'
import os
import pty
import struct
import sys
import threading
import tty
import types
from importlib.metadata import version
from unittest.mock import MagicMock

import numpy as np
from instrumental import Q_
from instrumental.drivers import ParamSet
from instrumental.drivers.motion.apt import TDC001_APT
from instrumental.fitting import curve_fit

times, volts, sigma = np.array([0.0, 1.0, 2.0]), np.array([1.0, 1.0, 4.0]), np.array([1.0, 1.0, 1e6])


def level(x, value):
    return value + 0 * x


plain = curve_fit(level, times, volts, [1.0], sigma)[0][0]
units = curve_fit(level, Q_(times, "s"), Q_(volts, "V"), [Q_(1.0, "V")], sigma)[0][0].magnitude
print("instrumental", version("Instrumental-lib"), "a level of 1, 1 and an outlier of 4: plain", round(plain, 6), "with units", round(units, 6))

device, computer = pty.openpty()
tty.setraw(device), tty.setraw(computer)


def controller():
    while True:
        if os.read(device, 6)[:2] == b"\x17\x04":  # jog parameters: steps of 1 mm by 1 mm/s and 1 mm/s^2
            os.write(device, bytes([0x18, 4, 22, 0, 0x81, 0x50]) + struct.pack("<HHiiiiH", 1, 2, 34304, 0, 262, 767367, 2))


threading.Thread(target=controller, daemon=True).start()
step, velocity, acceleration = TDC001_APT._create(ParamSet(TDC001_APT, port=os.ttyname(computer))).get_jog_params()
print("1 mm, 1 mm/s, 1 mm/s^2 are", step, velocity, acceleration)

# Stand-ins for the C library of Thorlabs and its wrapper, which there is for Windows alone.
sys.modules["cffi"] = MagicMock()
sys.modules["nicelib"] = types.SimpleNamespace(NiceLib=object, NiceObject=object, Sig=MagicMock(), RetHandler=lambda **_: lambda function: function, ret_return=0, ret_ignore=0)
from instrumental.drivers.motion.tdc_001 import TDC001

told = {flags: [name for name, value in vars(TDC001.Status(flags)).items() if value is True] for flags in (0x00000001, 0x00000400, 0x80000000)}
for flags, names in told.items():
    print(f"{flags:#010x}", names)
assert abs(plain - 1) < 1e-6 and abs(units - 2) < 1e-6, "sigma: the behaviour has changed"
assert abs(velocity.magnitude - 0.000341) < 1e-6 and abs(acceleration.magnitude - 2929.66) < 0.01, "jogs: the behaviour has changed"
assert told[0x80000000] == ["isEnabled"]
assert {"CW_LimSwitch_Contact", "CCW_LimSwitch_Contact", "isMoving", "MotorHomed"} <= set(told[1]), "flags: the behaviour has changed"
PY
