"""The cost of an upload of masks to a DLP6500: coding time, size, and transfer time.

Run from the checkout: `python -m tests.benchmarks pattern_encoding`. Nothing here is asserted.
"""

import numpy as np
from rich.console import Console
from rich.table import Table

from gs2ci.core.arrays import U8
from gs2ci_drivers.dlpc900.images import HEADER_BYTES, Compression, encode_block, pack_planes
from gs2ci_drivers.dlpc900.timing import upload_s
from gs2ci_sims.wires.dlpc900_images import read_image
from tests.benchmarks.scaling import ROUNDS, fastest

HEIGHT, WIDTH, PLANES = 1080, 1920, 24


def _random(cell_px: int) -> U8:
    shape = (PLANES, -(-HEIGHT // cell_px), -(-WIDTH // cell_px))
    cells = np.random.default_rng(0).integers(0, 2, shape, dtype=np.uint8)
    whole = cells.repeat(cell_px, axis=1).repeat(cell_px, axis=2)
    return np.ascontiguousarray(whole[:, :HEIGHT, :WIDTH])


def _checker() -> U8:
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    return np.stack([(x + y + k) % 2 for k in range(PLANES)]).astype(np.uint8)


def run() -> None:
    """Print one row per kind of masks and coding."""
    masks = {
        "random 1 × 1": _random(1),
        "random 2 × 2": _random(2),
        "random 4 × 4": _random(4),
        "checker": _checker(),
        "all on": np.ones((PLANES, HEIGHT, WIDTH), np.uint8),
    }
    table = Table(title=f"{PLANES} masks of {HEIGHT} × {WIDTH} mirrors, one image; best of {ROUNDS}")
    for column in ("masks", "coding", "pack / s", "encode / s", "read back / s", "size / MB", "upload / s"):
        table.add_column(column, justify="left" if column in {"masks", "coding"} else "right")
    for name, planes in masks.items():
        (words,) = pack_planes(planes)
        pack_s = fastest(lambda planes=planes: pack_planes(planes))
        for compression in (Compression.ERLE, Compression.RLE):
            block = encode_block(words, compression)
            encode_s = fastest(lambda words=words, compression=compression: encode_block(words, compression))
            decode_s = fastest(lambda block=block: read_image(block, WIDTH, HEIGHT))
            table.add_row(
                name,
                compression.name,
                f"{pack_s:.4f}",
                f"{encode_s:.4f}",
                f"{decode_s:.4f}",
                f"{(len(block) - HEADER_BYTES) / 1e6:.3f}",
                f"{upload_s(len(block)):.1f}",
            )
    Console().print(table)
