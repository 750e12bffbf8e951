"""That a processor is played, not only named: what the libraries then say of themselves, and what Numba compiles."""

import json
import os
import subprocess
import sys

import numpy as np
import pytest

from tests import processors

_SAY = """
import json, cv2, numba, numpy as np, torch
@numba.njit(fastmath=True)
def dot(a, b):
    total = np.float32(0)
    for i in range(a.size):
        total += a[i] * b[i]
    return total
dot(np.ones(9, np.float32), np.ones(9, np.float32))
code = next(iter(dot.inspect_asm().values()))
print(json.dumps({
    "numba": [register for register in ("xmm", "ymm", "zmm") if register in code],
    "torch": torch.backends.cpu.get_cpu_capability(),
    "numpy": [name for name in np._core._multiarray_umath.__cpu_dispatch__
              if np._core._multiarray_umath.__cpu_features__[name]],
    "opencv": cv2.getCPUFeaturesLine(),
}))
"""
_HERE = np._core._multiarray_umath.__cpu_features__


def said(name):
    """What Python, started as this processor, says of itself."""
    here = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    command = [sys.executable, "-m", "tests.processors", name, "-c", _SAY]
    answer = subprocess.run(command, env=here, check=True, capture_output=True, text=True)
    assert not answer.stderr
    return json.loads(answer.stdout)


@pytest.mark.skipif(not _HERE["X86_V2"], reason="plays x86 processors on x86 processors")
def test_nehalem_has_registers_of_four_numbers():
    told = said("nehalem")
    assert (told["numba"], told["torch"], told["numpy"]) == (["xmm"], "DEFAULT", [])
    assert "*AVX2?" in told["opencv"]


@pytest.mark.skipif(not _HERE["X86_V3"], reason="this processor has no AVX2")
def test_haswell_has_avx2_and_no_avx512():
    told = said("haswell")
    assert ("ymm" in told["numba"], "zmm" in told["numba"]) == (True, False)
    assert (told["torch"], told["numpy"]) == ("AVX2", ["X86_V3"])
    assert "*AVX2?" not in told["opencv"]


@pytest.mark.parametrize(
    ("here", "already", "disabled"),
    [
        ("SSE *AVX2 *AVX512-SKX", "", ["AVX512-SKX", "AVX2"]),
        ("SSE *AVX2 *AVX512-SKX?", "", ["AVX2"]),
        ("SSE *AVX2 *AVX512-SKX?", "AVX512-SKX", ["AVX512-SKX", "AVX2"]),
    ],
)
def test_opencv_is_asked_to_disable_only_what_is_here_or_disabled_already(monkeypatch, here, already, disabled):
    monkeypatch.setattr(processors.cv2, "getCPUFeaturesLine", lambda: here)
    monkeypatch.setenv("OPENCV_CPU_DISABLE", already)
    assert processors._opencv_groups_here(["AVX512-SKX", "AVX2"]) == disabled


def test_a_processor_that_cannot_be_played_is_refused(monkeypatch):
    with pytest.raises(SystemExit, match=r"usage: .*haswell"):
        processors.main(["z80", "-m", "pytest"])
    monkeypatch.setattr(processors, "_features", lambda: {"X86_V3": False})
    with pytest.raises(SystemExit, match="cannot play haswell: it has no AVX2"):
        processors.main(["haswell", "-m", "pytest"])
