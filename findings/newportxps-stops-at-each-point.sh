#!/usr/bin/env bash
# A good guess: newportxps writes trajectories for Newport's XPS that pass evenly spaced points at even speed, with trigger pulses midway between
# them, and refuses those beyond a stage's velocity; and a line from 10 to 0 is that from 0 to 10 turned round. Found: define_array_trajectory() has
# velocities of 0 at all pulses, so that the stage stops at each, for it takes differences of differences; points 10 mm and 1 s apart pass a limit
# of 5 mm/s; and pulses come late by up to seven eighths of a step, from where it sends the stage first. In the line from 10 to 0 of
# define_line_trajectories_general() ramps and velocities stay those forwards: at 2 mm/s forwards, back at up to 4, and forwards again.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --no-compile --disable-pip-version-check --no-deps newportxps==2026.1.1 numpy==2.4.6 tabulate==0.10.0
v/bin/python - <<'PY'
import sys
from importlib.metadata import version
from types import ModuleType

import numpy as np

sys.modules["paramiko"] = ModuleType("paramiko")  # by which it would upload files
from newportxps import NewportXPS

LIMITS = {"max_velo": 5.0, "max_accel": 20.0}


def controller():
    """Return the object of a controller with one axis, without a connection."""
    xps = NewportXPS.__new__(NewportXPS)
    xps.groups, xps.stages = {"G": {"positioners": ["X"]}}, {"G.X": LIMITS}
    xps.traj_group, xps.traj_positioners, xps.trajectories = "G", ["X"], {}
    xps._sid, xps._xps = 1, None
    xps.upload_trajectory = lambda name, text: None
    return xps


def segments(text):
    """Return for each segment its time, its way and the velocity at its end."""
    return np.array([[float(number) for number in line.split(",")] for line in text.splitlines() if line])


def speeds(rows):
    """Return the velocity along cubics of those times, ways and velocities, as the controller interpolates."""
    along, before = [], 0.0
    for time, way, after in rows:
        part = np.linspace(0, 1, 101)
        along.append(before * (1 - 4 * part + 3 * part**2) + 6 * way / time * (part - part**2) + after * (3 * part**2 - 2 * part))
        before = after
    return np.concatenate(along)


found = {}
for step, time in ((0.1, 0.5), (1.0, 0.5), (10.0, 1.0)):
    points = np.arange(11) * step
    made = controller().define_array_trajectory({"X": points}, dtime=time, upload=False)
    rows = segments(made["pvt_buffer"])
    pulses = made["start"]["X"] + np.cumsum(rows[:, 1])
    late = pulses[0] - (points[0] - step / 2)
    found[step] = float(np.abs(rows[:, 2]).max()), float(speeds(rows).max()), float(late)
    print("newportxps", version("newportxps"), f"points {step:g} mm and {time:g} s apart from 0 on: velocities up to {found[step][0]:.2g} mm/s where segments end, up to {found[step][1]:.3g} within (limit {LIMITS['max_velo']:g}); pulses at {pulses[:4].round(4).tolist()} ... mm, {late:.4f} late")
lines = {}
for begin, end in ((0.0, 10.0), (10.0, 0.0)):
    rows = segments(controller().define_line_trajectories_general(start_values=[begin], stop_values=[end], scan_time=5.0))
    lines[begin] = rows, speeds(rows)
    print(f"a line from {begin:g} to {end:g} mm in 5 s: times, ways and velocities {rows.tolist()}, {lines[begin][1].min():.2f} to {lines[begin][1].max():.2f} mm/s on the way")
assert np.allclose(lines[0.0][0], [[0.15, 0.3, 2], [5, 10, 2], [0.15, 0.3, 0]]), "lines: the behaviour has changed"
assert np.allclose(lines[10.0][0], [[0.15, 0.3, 2], [5, -10, 2], [0.15, 0.3, 0]]), "lines turned round: the behaviour has changed"
assert all(values[0] < 1e-6 for values in found.values()), "velocities: the behaviour has changed"
assert found[10.0][1] > 2.5 * LIMITS["max_velo"], "limits: the behaviour has changed"
assert np.allclose([found[step][2] for step in (0.1, 1.0, 10.0)], [0.0875, 0.875, 0]), "pulses: the behaviour has changed"
PY
