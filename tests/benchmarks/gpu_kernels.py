"""Registers, stack and shared memory of the Warp kernels on three generations of cards, without a card or a toolkit.

    python -m tests.benchmarks gpu_kernels

The wheel of warp-lang brings NVRTC, which makes machine code for any architecture. What a kernel keeps on the stack
has been spilled out of registers, or is indexed in a way that the compiler could not resolve.
"""

import struct
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

ARCHITECTURES = {75: "Turing", 86: "Ampere", 90: "Hopper"}
# Attributes of `.nv.info` that hold a figure for each kernel; NVIDIA documents them in cuobjdump's output alone.
_REGISTERS, _FRAME, _STACK = 0x2F, 0x11, 0x12
_OF_SYMBOL = 0x04


@dataclass(frozen=True)
class Kernel:
    """What one kernel takes: registers of a thread, bytes of its stack, bytes of shared memory of a block."""

    name: str
    registers: int
    stack: int
    shared: int


def run() -> None:
    """Print the table; ends with an error where a kernel spills."""
    print("| kernel | " + " | ".join(f"sm_{arch}, {name}" for arch, name in ARCHITECTURES.items()) + " |")
    print("|---|" + "---:|" * len(ARCHITECTURES))
    by_arch = {arch: {one.name: one for one in compiled(arch)} for arch in ARCHITECTURES}
    for name in by_arch[90]:
        cells = (by_arch[arch][name] for arch in ARCHITECTURES)
        print(f"| {name} | " + " | ".join(f"{one.registers}, {one.stack}, {one.shared}" for one in cells) + " |")
    if any(one.stack for kernels in by_arch.values() for one in kernels.values()):
        print("A kernel spills.", file=sys.stderr)
        raise SystemExit(1)


def modules() -> list[tuple[Any, int]]:
    """Return the modules of all kernels, and the threads of their blocks."""
    import warp as wp  # noqa: PLC0415  an extra

    from gs2ci.reconstruct.fit.kernels.device import kernels  # noqa: PLC0415
    from gs2ci.reconstruct.fit.losses import device_loss_kernels  # noqa: PLC0415
    from gs2ci.render.warp import blend, lists, project, stopping  # noqa: PLC0415

    whole = (blend, lists, project, stopping, kernels, device_loss_kernels)
    plain = [(wp.get_module(one.__name__), 256) for one in whole]
    return [(kernel.module, threads) for kernel, threads in launched_by_blocks()] + plain


def compiled(arch: int) -> list[Kernel]:
    """Compile every kernel for an architecture, and read what it takes."""
    import warp as wp  # noqa: PLC0415  an extra

    found = []
    for module, threads in modules():
        module.options["block_dim"] = threads
        with tempfile.TemporaryDirectory() as folder:
            wp.compile_aot_module(module, device=None, arch=arch, module_dir=folder, use_ptx=False)
            for path in Path(folder).glob("*.cubin"):
                found += kernels_in(path.read_bytes())
    return found


def launched_by_blocks() -> list[tuple[Any, int]]:
    """Return the kernels whose threads wait for each other, each in a module of its own, and their blocks' threads."""
    from gs2ci.reconstruct.fit.kernels.device import kernels  # noqa: PLC0415  an extra
    from gs2ci.reconstruct.fit.losses import device_loss_kernels  # noqa: PLC0415
    from gs2ci.reconstruct.geometry.depth import device_paths  # noqa: PLC0415
    from gs2ci.render.warp import blend, project  # noqa: PLC0415
    from gs2ci.render.warp.types import BLOCK  # noqa: PLC0415

    of_fit = [one for one in (*kernels.ALL, *device_loss_kernels.ALL) if one.module.name != one.func.__module__]
    tiled = [(blend.blend, BLOCK), (blend.blend_backward, BLOCK), (project.sum_poses, 256)]
    tiled += [(one, device_paths.THREADS) for one in device_paths.ALL]
    return tiled + [(one, int(kernels.SUMMED)) for one in of_fit]


def kernels_in(cubin: bytes) -> list[Kernel]:
    """Read a file of machine code (ELF): its kernels' names and what each takes."""
    (start,) = struct.unpack_from("<Q", cubin, 0x28)
    size, count, names_at = struct.unpack_from("<HHH", cubin, 0x3A)
    headers = [struct.unpack_from("<IIQQQQIIQQ", cubin, start + size * k) for k in range(count)]
    strings = headers[names_at]
    sections = {_text(cubin, strings[4] + one[0]): one for one in headers}
    symbols, table = sections[".symtab"], sections[".strtab"]
    names = [
        _text(cubin, table[4] + struct.unpack_from("<I", cubin, symbols[4] + 24 * k)[0])
        for k in range(symbols[5] // 24)
    ]
    figures: dict[tuple[str, int], int] = {}
    info, at = sections[".nv.info"], 0
    while at < info[5]:
        kind, attribute, length = struct.unpack_from("<BBH", cubin, info[4] + at)
        at += 4
        if kind == _OF_SYMBOL:
            symbol, value = struct.unpack_from("<II", cubin, info[4] + at)
            figures[names[symbol], attribute] = value
            at += length
    kernels = []
    for symbol in sorted({name for name, attribute in figures if attribute == _REGISTERS}):
        shared = sections.get(f".nv.shared.{symbol}")
        short = symbol.split("_cuda_kernel_")[0].rpartition("_")[0]
        stack = max(figures.get((symbol, kind), 0) for kind in (_FRAME, _STACK))
        kernels.append(Kernel(short, figures[symbol, _REGISTERS], stack, shared[5] if shared else 0))
    return kernels


def _text(data: bytes, at: int) -> str:
    return data[at : data.index(b"\0", at)].decode()
