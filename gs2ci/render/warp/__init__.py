"""The rasteriser in NVIDIA Warp: one source for CUDA devices and, by fibers and for tests alone, for the CPU.

Never run on a GPU so far: what is known of it is what the CPU and the compiler tell (docs/gpu.md).
"""
