#!/usr/bin/env bash
# A good guess: slmsuite shows a phase p on an 8-bit spatial light modulator as the grey level 256 p / 2 pi, more phase by more grey. Found: the other
# way round: phase 0 is shown as 255, and more phase by less grey (pi as 127). A ramp that another program's picture of grey levels steers
# to one side goes to the other when the same numbers are given as phase.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check slmsuite==0.5.0 numpy==2.4.6
v/bin/python - <<'PY'
from importlib.metadata import version

import numpy as np
from slmsuite.hardware.slms.simulated import SimulatedSLM

slm = SimulatedSLM((64, 48))
phase = np.tile(2 * np.pi * np.arange(64) / 64, (48, 1))
slm.set_phase(phase, phase_correct=False)
shown = slm.display[0].astype(int).tolist()
print("slmsuite", version("slmsuite"), "phases 0, pi/2, pi, 3 pi/2 are shown as", shown[::16])
assert shown[0] == 255 and all(np.diff(shown) < 0) and shown[32] == 127, "the behaviour has changed"
PY
