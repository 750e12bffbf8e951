#!/usr/bin/env bash
# A good guess: pylablib's setup_scan_move(velocity=0.1) of SmarAct's controller MCS2 sets the velocity of scans, and leaves the amplitude of steps.
# Found: it writes the velocity, times 65535, into the amplitude of steps: steps are a tenth as long from then on, and scans as fast as before.
# And the status of an axis that is too hot is empty, while one beyond its limit of the following error is said to be too hot:
# the bit is given as 0x400, which the driver's own table of SmarAct's names has as 0x4000. Shown with a stand-in for SmarAct's C library.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v
v/bin/pip install --quiet --no-compile --disable-pip-version-check --no-deps pylablib==1.4.5 numpy==2.4.6 scipy==1.17.1 pandas==3.1.1 python-dateutil==2.9.0.post0 six==1.17.0
v/bin/python - <<'PY'
import sys
from importlib.metadata import version

import pylablib.devices.SmarAct
from pylablib.devices.SmarAct.SmarActControl_defs import SA_CTL_CH_STATE as State
from pylablib.devices.SmarAct.SmarActControl_defs import SA_CTL_PKEY as Key
from pylablib.devices.SmarAct.SmarActControl_defs import SA_CTL_UNIT as Unit


class Library:
    """Stands in for SmarAct's library: it keeps what is written, by the key of the property."""

    def __init__(self):
        self.kept = {
            Key.SA_CTL_PKEY_NUMBER_OF_CHANNELS: 1,
            Key.SA_CTL_PKEY_NUMBER_OF_BUS_MODULES: 1,
            Key.SA_CTL_PKEY_POS_BASE_UNIT: int(Unit.SA_CTL_UNIT_METER),
            Key.SA_CTL_PKEY_STEP_AMPLITUDE: 65535,
            Key.SA_CTL_PKEY_SCAN_VELOCITY: 65535,
        }

    def initlib(self):
        return None

    def SA_CTL_Open(self, locator, options):
        return 1

    def SA_CTL_GetProperty_i32(self, handle, index, key):
        return self.kept[key]

    def SA_CTL_SetProperty_i32(self, handle, index, key, value):
        self.kept[key] = value

    SA_CTL_GetProperty_i64, SA_CTL_SetProperty_i64 = SA_CTL_GetProperty_i32, SA_CTL_SetProperty_i32


module = sys.modules["pylablib.devices.SmarAct.MCS2"]
module.lib = module.libctl.lib = library = Library()
stage = module.MCS2("usb:sn:MCS2-0")
stage.setup_scan_move(velocity=0.1)
velocity, amplitude = library.kept[Key.SA_CTL_PKEY_SCAN_VELOCITY], library.kept[Key.SA_CTL_PKEY_STEP_AMPLITUDE]
print("pylablib", version("pylablib"), "scan velocity", velocity, "step amplitude", amplitude, "of 65535")
told = []
for bit in (State.SA_CTL_CH_STATE_BIT_OVER_TEMPERATURE, State.SA_CTL_CH_STATE_BIT_FOLLOWING_LIMIT_REACHED):
    library.kept[Key.SA_CTL_PKEY_CHANNEL_STATE] = int(bit)
    told.append(stage.get_status())
    print(f"{bit.name} = {int(bit):#06x} is told as", told[-1])
assert (velocity, amplitude) == (65535, 6553), "the behaviour has changed"
assert told == [[], ["following_limit_reached", "over_temperature"]], "the status has changed"
PY
