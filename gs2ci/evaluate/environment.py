"""The environment of a run: versions, machine, peak memory, so that its figures can be judged years later.

It contains nothing that identifies a person: no host name, no user, no path.
"""

import os
import platform
import resource
import sys
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from typing import Final

import psutil

from gs2ci.core.run_figures import Count

CPU_LISTING: Final = Path("/proc/cpuinfo")
PEAK_RESET: Final = Path("/proc/self/clear_refs")
PROCESS_STATUS: Final = Path("/proc/self/status")
REPORTED_PACKAGES: Final = (
    "gs2ci",
    "numpy",
    "torch",
    "numba",
    "scipy",
    "scikit-image",
    "opencv-contrib-python-headless",
    "pycolmap",
)


@dataclass(frozen=True)
class Machine:
    """What determines the run time: `usable_cores` are those that a process may use."""

    processor: str
    architecture: str
    usable_cores: Count
    memory_mib: Count
    system: str


def versions() -> dict[str, str]:
    """Get the versions of Python and of the packages that affect the figures."""
    found = {"python": platform.python_version()}
    for package in REPORTED_PACKAGES:
        try:
            found[package] = metadata.version(package)
        except metadata.PackageNotFoundError:
            found[package] = "not installed"
    return found


def machine() -> Machine:
    """Get what determines the run time of this process."""
    return Machine(
        processor=_processor_name(),
        architecture=platform.machine(),
        usable_cores=len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1,
        memory_mib=int(psutil.virtual_memory().total // 2**20),
        system=f"{platform.system()} {platform.release()}",
    )


def restart_peak() -> bool:
    """Let the peak of this process's memory start anew, at what it holds now; False where that cannot be (Linux can).

    5 resets the peak alone (proc_pid_clear_refs(5)).
    """
    try:
        PEAK_RESET.write_text("5")
    except OSError:
        return False
    return True


def peak_mib() -> float:
    """Measure the largest memory this process has held, in MiB: since `restart_peak` on Linux, else since its start."""
    # ru_maxrss would include what the process held before an exec, as a copy of its parent, and that does not restart.
    if PROCESS_STATUS.is_file():
        for line in PROCESS_STATUS.read_text(errors="replace").splitlines():
            if line.startswith("VmHWM:"):
                return int(line.split()[1]) / 2**10
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    # getrusage counts in bytes on macOS, in kibibytes elsewhere (getrusage(2)).
    return peak / 2**20 if sys.platform == "darwin" else peak / 2**10


def _processor_name() -> str:
    if CPU_LISTING.is_file():
        for line in CPU_LISTING.read_text(errors="replace").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()
