"""Runs check files inside a guest with a real kernel, booted by a rig script that the user names.

The script is called as `SCRIPT --share CHECKOUT --pip PACKAGES [--modprobe MODULE]... -- COMMAND`; it must boot a Linux
guest that has vivid, v4l2loopback, vhci-hcd, usbhid, dummy_hcd and python 3.11 or newer with numpy, pyserial, pyusb,
pytest and PACKAGES, let the command run in the checkout, and exit with its status.
"""

import os
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

CHECKOUT = Path(__file__).parents[2]
TIMEOUT_S = 540
PACKAGES = "pydantic h5py"


@pytest.fixture(scope="session")
def rig_script() -> Path:
    """The script that boots the guest."""
    named = os.environ.get("GS2CI_KERNEL_RIG", "")
    if not named:
        pytest.skip("needs a guest with a real kernel: `make kernel RIG=path/to/rig-script`")
    script = Path(named).resolve()
    if not os.access(script, os.X_OK):
        pytest.fail(f"GS2CI_KERNEL_RIG={named} is no executable file")
    return script


@pytest.fixture
def in_guest(rig_script: Path) -> Callable[..., None]:
    """Run one check file in a fresh guest and fail with its report if it fails."""

    def run(check: str, *modules: str) -> None:
        command = [str(rig_script), "--share", str(CHECKOUT), "--timeout", str(TIMEOUT_S), "--pip", PACKAGES]
        for module in modules:
            command += ["--modprobe", module]
        checks = "tests/kernel/guest"
        command += ["--", "python3", "-m", "pytest", "-v", "-c", f"{checks}/pytest.ini", f"{checks}/{check}"]
        done = subprocess.run(command, capture_output=True, text=True, timeout=TIMEOUT_S + 300, check=False)
        print(done.stdout)
        if done.returncode != 0:
            report = f"{check} in the guest: status {done.returncode}\n{done.stdout}\n{done.stderr}"
            pytest.fail(report, pytrace=False)

    return run
