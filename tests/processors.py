"""Run Python as if on another processor: fewer vector instructions, so other kernels, other rounding.

    make test-as CPU=haswell TESTS=tests/reconstruct
    python -m tests.processors haswell -m pytest tests/reconstruct

Here: which environment makes each library choose the kernels that it would choose there, and the start of Python in it.
Not played: onnxruntime and pycolmap, which take no such word, and anything slower or smaller about the other machine.
"""

import os
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

_CACHES = Path(__file__).resolve().parents[1] / "build" / "numba"
"""Compiled functions of each processor, apart, so that no other's are found or thrown out."""


@dataclass(frozen=True)
class Level:
    """A set of vector instructions, in each library's word for it.

    Args:
        numpy: The name of NumPy's dispatched group that needs it; None where the baseline is all there is.
        torch: ATEN_CPU_CAPABILITY.
        mkl: MKL_ENABLE_INSTRUCTIONS; torch's matrix products.
        onednn: ONEDNN_MAX_CPU_ISA; torch's convolutions.
        openblas: OPENBLAS_CORETYPE; the matrix products of NumPy and SciPy.
        opencv: OPENCV_CPU_DISABLE.
        ipp: OPENCV_IPP.
        libm: What of the C library's is disabled by GLIBC_TUNABLES.
    """

    numpy: str | None
    torch: str
    mkl: str
    onednn: str
    openblas: str
    opencv: str
    ipp: str
    libm: str


SSE4 = Level(
    None, "default", "SSE4_2", "SSE41", "Nehalem", "AVX512-SKX,AVX2,AVX,FP16", "sse42", "-AVX512F,-AVX2,-FMA,-AVX"
)
AVX2 = Level("X86_V3", "avx2", "AVX2", "AVX2", "Haswell", "AVX512-SKX", "avx2", "-AVX512F")

PROCESSORS = {"nehalem": SSE4, "haswell": AVX2, "skylake": AVX2, "znver1": AVX2, "znver3": AVX2}
"""By the names that LLVM, and so Numba, has for them."""


def environment(name: str) -> dict[str, str]:
    """Return what has to be set before Python starts for it to compute as on this processor.

    Raises:
        KeyError: No such processor here.
    """
    level = PROCESSORS[name]
    return {
        "NUMBA_CPU_NAME": name,
        "NUMBA_CPU_FEATURES": "",  # else this machine's own, whatever the name
        "NUMBA_CACHE_DIR": str(_CACHES / name),
        "NPY_DISABLE_CPU_FEATURES": " ".join(_numpy_groups_without(level.numpy)),
        "ATEN_CPU_CAPABILITY": level.torch,
        "MKL_ENABLE_INSTRUCTIONS": level.mkl,
        "ONEDNN_MAX_CPU_ISA": level.onednn,
        "OPENBLAS_CORETYPE": level.openblas,
        "OPENCV_CPU_DISABLE": ",".join(_opencv_groups_here(level.opencv.split(","))),
        "OPENCV_IPP": level.ipp,
        "GLIBC_TUNABLES": f"glibc.cpu.hwcaps={level.libm}",
    }


def _numpy_groups_without(group: str | None) -> list[str]:
    """Name the groups to disable: those beyond one that NumPy would choose here, for it warns of any other.

    Those that are disabled already stay so: a played processor may start another.
    """
    groups = np._core._multiarray_umath.__cpu_dispatch__
    above = groups[0 if group is None else groups.index(group) + 1 :]
    already = os.environ.get("NPY_DISABLE_CPU_FEATURES", "").split()
    return [name for name in above if _features()[name] or name in already]


def _opencv_groups_here(groups: list[str]) -> list[str]:
    """Return those of OpenCV's groups that are here, for it warns of any other, and those that are disabled already."""
    missing = {word.strip("*?") for word in cv2.getCPUFeaturesLine().split() if word.endswith("?")}
    already = os.environ.get("OPENCV_CPU_DISABLE", "").split(",")
    return [name for name in groups if name not in missing or name in already]


def _features() -> dict[str, bool]:
    return np._core._multiarray_umath.__cpu_features__


def main(arguments: Sequence[str]) -> None:
    """Start Python with the arguments after the processor's name; this process becomes it."""
    if not arguments or arguments[0] not in PROCESSORS:
        raise SystemExit(f"usage: python -m tests.processors {{{','.join(PROCESSORS)}}} <arguments of python>")
    name, *rest = arguments
    level = PROCESSORS[name]
    if level.numpy is not None and not _features()[level.numpy]:
        raise SystemExit(f"this machine cannot play {name}: it has no {level.mkl} itself")
    os.execve(sys.executable, [sys.executable, *rest], {**os.environ, **environment(name)})


if __name__ == "__main__":
    main(sys.argv[1:])
