"""Damage to a file between the exposure and the reconstruction: truncated, of another version, or hostile.

Every damage changes a file in place. Not here: numbers inside a sound file (`changes`), the expected outcome of a case
(`cases`).
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np

Damage = Callable[[Path], None]
HUGE = 2**20


def none(_path: Path) -> None:
    """Leave the file as it was written."""


def cut(share: float) -> Damage:
    """Keep only this share of the bytes, as a full disk or a broken transfer does."""

    def damage(path: Path) -> None:
        data = path.read_bytes()
        path.write_bytes(data[: int(share * len(data))])

    return damage


def overwritten(content: bytes) -> Damage:
    """Be another thing altogether under the same name."""

    def damage(path: Path) -> None:
        path.write_bytes(content)

    return damage


def flipped(every: int) -> Damage:
    """Flip one bit in every so many bytes, as a failing disk does."""

    def damage(path: Path) -> None:
        data = bytearray(path.read_bytes())
        data[every // 2 :: every] = bytes(byte ^ 0x10 for byte in data[every // 2 :: every])
        path.write_bytes(data)

    return damage


def of_schema(name: str) -> Damage:
    """Claim another layout or version."""
    return _inside(lambda file: file.attrs.__setitem__("schema", name))


def without(key: str) -> Damage:
    """Lack a part."""
    return _inside(lambda file: file.__delitem__(key))


def linked(key: str, link: Any) -> Damage:
    """Point elsewhere instead of holding a part."""
    return _inside(lambda file: (file.__delitem__(key), file.__setitem__(key, link)))


def claiming(key: str, shape: tuple[int, ...], chunks: tuple[int, ...]) -> Damage:
    """Claim numbers without end, compressed to nothing."""
    return _replaced(key, lambda f: f.create_dataset(key, shape, "f4", chunks=chunks, compression="gzip"))


def in_one_chunk(key: str, shape: tuple[int, ...], side: int) -> Damage:
    """Keep few numbers in one chunk that unpacks to gigabytes."""
    options = {
        "maxshape": (None,) * len(shape),
        "chunks": (*(1,) * (len(shape) - 2), side, side),
        "compression": "gzip",
    }
    return _replaced(key, lambda f: f.create_dataset(key, shape, "u1", **options))


def in_another_file(path: Path) -> None:
    """Hold no pixel, but the name of a file from which to read them."""
    with h5py.File(path, "r+") as file:
        shape = file["meas"].shape
        del file["meas"]
        file.create_dataset("meas", shape, "f4", external=[("elsewhere.bin", 0, h5py.h5f.UNLIMITED)])


def of_text(key: str) -> Damage:
    """Hold a book where numbers belong."""
    return _replaced(key, lambda f: f.create_dataset(key, data=np.bytes_("x" * 20_000_000)))


def _replaced(key: str, make: Callable[[h5py.File], object]) -> Damage:
    return _inside(lambda file: (file.__delitem__(key), make(file)))


def _inside(change: Callable[[h5py.File], object]) -> Damage:
    def damage(path: Path) -> None:
        with h5py.File(path, "r+") as file:
            change(file)

    return damage
