"""Gaussian scenes as PLY files, in the convention of 3D Gaussian splatting that viewers open; any PLY as bytes.

One element `vertex` with x y z, nx ny nz (zero, some readers insist on them), f_dc_0..2, opacity, scale_0..2, rot_0..3:
opacity is a logit, scales are natural logs, rotations are (w, x, y, z), and the colour is 0.5 + SH_DC f_dc, SH_DC being
the constant spherical harmonic. Higher harmonics, f_rest_0 ..., run over their K = 3, 8 or 15 coefficients of red, then
green, then blue. Format: Greg Turk, "The PLY polygon file format" (1994).
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any, Final

import numpy as np
import torch
from numpy.typing import NDArray

from gs2ci.core.arrays import F32
from gs2ci.core.errors import InputError, reason_of
from gs2ci.core.whole_file import write_whole
from gs2ci.render.gaussians import Gaussians
from gs2ci.render.harmonics import DEGREE_MAX, SH_DC, coefficients

_POSITION: Final = ("x", "y", "z")
_NORMAL: Final = ("nx", "ny", "nz")
_COLOUR: Final = ("f_dc_0", "f_dc_1", "f_dc_2")
_OPACITY: Final = ("opacity",)
_SCALE: Final = ("scale_0", "scale_1", "scale_2")
_ROTATION: Final = ("rot_0", "rot_1", "rot_2", "rot_3")
ERROR_PROPERTY: Final = "standard_error"
_REQUIRED: Final = (*_POSITION, *_COLOUR, *_OPACITY, *_SCALE, *_ROTATION)
_BEFORE_REST: Final = (*_POSITION, *_NORMAL, *_COLOUR)
_AFTER_REST: Final = (*_OPACITY, *_SCALE, *_ROTATION)

_TYPES: Final = {
    "char": "i1",
    "uchar": "u1",
    "short": "i2",
    "ushort": "u2",
    "int": "i4",
    "uint": "u4",
    "float": "f4",
    "double": "f8",
    "int8": "i1",
    "uint8": "u1",
    "int16": "i2",
    "uint16": "u2",
    "int32": "i4",
    "uint32": "u4",
    "float32": "f4",
    "float64": "f8",
}
_FORMATS: Final = ("ascii", "binary_little_endian")
_HEADER_BYTES_MAX: Final = 1 << 20


@dataclass(frozen=True)
class PlyScene:
    """A scene read from a file, and the names of the properties that were ignored.

    Args:
        gaussians: float32; without harmonics if the file has none, or only zeros.
        ignored: Names of other properties, which were skipped.
        standard_errors: Of the centres, in the unit of the scene, [G] float32; None if the file has none.
    """

    gaussians: Gaussians
    ignored: tuple[str, ...]
    standard_errors: F32 | None = None


@dataclass(frozen=True)
class _Header:
    text: bool
    count: int
    properties: tuple[tuple[str, str], ...]  # (name, numpy type)


def read_ply(path: str | Path) -> Gaussians:
    """Read a scene without the list of ignored properties.

    Raises:
        InputError: See `read_ply_scene`.
    """
    return read_ply_scene(path).gaussians


def read_ply_scene(path: str | Path) -> PlyScene:
    """Read a scene written by gs2ci, gsplat, the original 3DGS code or anything that keeps its convention.

    Raises:
        InputError: No such file, not a PLY file of an accepted format, a required property is missing, harmonics
            are incomplete or of too high a degree, or the data is short, malformed, NaN or infinite.
    """
    path = Path(path)
    try:
        with path.open("rb") as file:
            header = _read_header(path, file)
            table = _read_text(path, file, header) if header.text else _read_binary(path, file, header)
    except OSError as error:
        raise InputError(f"{path}: {reason_of(error)}", remedy="check the path") from error
    rest = _rest_names(path, header)
    known = {*_REQUIRED, *_NORMAL, *rest, ERROR_PROPERTY}
    gaussians = Gaussians(
        means=_columns(table, _POSITION),
        log_scales=_columns(table, _SCALE),
        quaternions=_columns(table, _ROTATION),
        opacity_logits=_columns(table, _OPACITY).squeeze(1),
        colours=0.5 + SH_DC * _columns(table, _COLOUR),
        harmonics=_harmonics(table, rest),
    )
    try:
        gaussians.check()
    except InputError as error:
        raise InputError(f"{path}: {error.problem}", allowed="finite numbers") from error
    return PlyScene(
        gaussians,
        ignored=tuple(name for name, _ in header.properties if name not in known),
        standard_errors=_errors(path, table),
    )


def _errors(path: Path, table: NDArray[Any]) -> F32 | None:
    if ERROR_PROPERTY not in (table.dtype.names or ()):
        return None
    found: F32 = _columns(table, (ERROR_PROPERTY,))[:, 0].numpy()
    if not (np.isfinite(found) & (found >= 0)).all():
        raise InputError(f"{path}: a {ERROR_PROPERTY} that is none", allowed="finite numbers from 0 on")
    return found


def _rest_names(path: Path, header: _Header) -> tuple[str, ...]:
    found = {name for name, _ in header.properties if name.startswith("f_rest_")}
    names = tuple(f"f_rest_{k}" for k in range(len(found)))
    allowed = [3 * coefficients(degree) for degree in range(DEGREE_MAX + 1)]
    if found != set(names) or len(names) not in allowed:
        raise InputError(
            f"{path}: {len(found)} properties f_rest_*",
            allowed=f"f_rest_0 ... of {', '.join(map(str, allowed))} in all: harmonics of degree 0 to {DEGREE_MAX}",
        )
    return names


def _harmonics(table: NDArray[Any], names: tuple[str, ...]) -> torch.Tensor | None:
    if not any(bool(table[name].any()) for name in names):
        return None
    return _columns(table, names).reshape(len(table), 3, -1).transpose(1, 2).contiguous()


def _columns(table: NDArray[Any], names: tuple[str, ...]) -> torch.Tensor:
    # The dtype is given, since an empty stack of columns has none of its own.
    with np.errstate(over="ignore"):
        return torch.from_numpy(np.stack([table[name].astype(np.float32) for name in names], axis=1))


def _read_header(path: Path, file: IO[bytes]) -> _Header:
    lines = _header_lines(path, file)
    if lines[0] != ["ply"]:
        raise InputError(f"{path} is not a PLY file", allowed="a file beginning with the line 'ply'")
    layout, elements = _parse_elements(path, lines[1:])
    if layout not in _FORMATS:
        raise InputError(f"{path}: PLY format {layout!r}", allowed=", ".join(_FORMATS))
    if not elements or elements[0][0] != "vertex":
        first = elements[0][0] if elements else "none"
        raise InputError(f"{path}: the first element is {first!r}", allowed="'vertex', one per Gaussian")
    _, count, properties = elements[0]
    names = [name for name, _ in properties]
    missing = [name for name in _REQUIRED if name not in names]
    if missing:
        raise InputError(
            f"{path} lacks the properties {', '.join(missing)}",
            allowed=f"at least {', '.join(_REQUIRED)}",
            remedy="export the scene in the 3DGS convention; a plain point cloud holds no Gaussians",
        )
    if len(set(names)) != len(names):
        raise InputError(f"{path} names a property twice", allowed="distinct names")
    return _Header(layout == "ascii", count, tuple(properties))


def _header_lines(path: Path, file: IO[bytes]) -> list[list[str]]:
    lines: list[list[str]] = []
    size = 0
    while True:
        raw = file.readline(_HEADER_BYTES_MAX)
        size += len(raw)
        if not raw.endswith(b"\n") or size > _HEADER_BYTES_MAX:
            if not lines:
                raise InputError(f"{path} is not a PLY file", allowed="a file beginning with the line 'ply'")
            raise InputError(f"{path}: the PLY header has no end", allowed="a line 'end_header'")
        words = raw.decode("latin-1").split()
        if words == ["end_header"]:
            return lines or [[]]
        lines.append(words)
        if lines[0] != ["ply"]:
            return lines


def _parse_elements(path: Path, lines: list[list[str]]) -> tuple[str, list[tuple[str, int, list[tuple[str, str]]]]]:
    layout = ""
    elements: list[tuple[str, int, list[tuple[str, str]]]] = []
    for words in lines:
        match words:
            case [] | ["comment", *_] | ["obj_info", *_]:
                pass
            case ["format", name, "1.0"]:
                layout = name
            case ["element", name, count] if count.isdecimal():
                elements.append((name, int(count), []))
            case ["property", type_, name] if elements and type_ in _TYPES:
                elements[-1][2].append((name, _TYPES[type_]))
            case ["property", "list", *_] if elements and elements[-1][0] != "vertex":
                pass  # other elements, such as faces, may follow the Gaussians
            case _:
                raise InputError(
                    f"{path}: PLY header line {' '.join(words)!r} makes no sense",
                    allowed="format, element and property lines; vertex properties of plain number types",
                )
    return layout, elements


def _read_binary(path: Path, file: IO[bytes], header: _Header) -> NDArray[Any]:
    dtype = np.dtype([(name, f"<{type_}") for name, type_ in header.properties])
    wanted = dtype.itemsize * header.count
    data = file.read(wanted)
    if len(data) < wanted:
        raise InputError(
            f"{path} ends after {len(data) // dtype.itemsize} of {header.count} Gaussians",
            remedy="copy or export the file again",
        )
    return np.frombuffer(data, dtype)


def _read_text(path: Path, file: IO[bytes], header: _Header) -> NDArray[Any]:
    dtype = np.dtype([(name, "f8") for name, _ in header.properties])
    table = np.empty(header.count, dtype)
    for row in range(header.count):
        words = file.readline().split()
        try:
            # A tuple fills one row of the table; a wrong number of words or a word that is not a number raises an
            # error.
            table[row] = tuple(float(word) for word in words)
        except ValueError as error:
            raise InputError(
                f"{path}: Gaussian {row} of {header.count} reads {b' '.join(words)[:80].decode('latin-1')!r}",
                allowed=f"{len(header.properties)} numbers in a line",
                remedy="copy or export the file again",
            ) from error
    return table


def write_ply(path: str | Path, gaussians: Gaussians, *, degree: int = 0, standard_errors: F32 | None = None) -> Path:
    """Write a scene as binary little-endian PLY; the file appears whole or not at all.

    Args:
        path: Of the file; an existing file is replaced.
        gaussians: The scene; the format cannot store its motion.
        degree: Harmonics are written at least up to this degree, as zeros where the scene has none: viewers of SIBR's
            kind stop at a file without the 45 properties f_rest of degree 3.
        standard_errors: Of the centres, in the unit of the scene, [G]: one more property, `standard_error`, which other
            programs ignore; None leaves it out.

    Returns:
        The path written.

    Raises:
        InputError: The Gaussians do not fit together or hold NaN, or the degree is not 0 to 3.
        StorageError: The file cannot be written.
    """
    g = gaussians.check().detach().map(torch.Tensor.float)
    own = torch.zeros(len(g), 0, 3) if g.harmonics is None else g.harmonics
    held = torch.cat([own, torch.zeros(len(g), max(0, coefficients(degree) - own.shape[1]), 3)], dim=1)
    rest = held.transpose(1, 2).reshape(len(g), 3 * held.shape[1])
    columns = torch.cat(
        [
            *(g.means, torch.zeros_like(g.means), (g.colours - 0.5) / SH_DC, rest),
            *(g.opacity_logits[:, None], g.log_scales, g.quaternions),
        ],
        dim=1,
    )
    names = (*_BEFORE_REST, *(f"f_rest_{k}" for k in range(rest.shape[1])), *_AFTER_REST)
    vertices = named_columns(names, columns.numpy())
    if standard_errors is not None:
        vertices[ERROR_PROPERTY] = standard_errors
    return write_whole(path, ply_bytes(vertices))


def named_columns(names: Iterable[str], columns: NDArray[Any]) -> dict[str, NDArray[Any]]:
    """Return the columns of an array, [V, K], by names, for `ply_bytes`."""
    return dict(zip(names, columns.T, strict=True))


def ply_bytes(vertices: Mapping[str, NDArray[Any]], triangles: NDArray[Any] | None = None) -> bytes:
    """Lay vertices and triangles out as binary little-endian PLY.

    Args:
        vertices: Properties by name, [V] each: uint8, or numbers that are written as float32.
        triangles: Indices of vertices, [F, 3]; None writes no faces.
    """
    kinds = {name: "u1" if values.dtype == np.uint8 else "<f4" for name, values in vertices.items()}
    table = np.empty(len(next(iter(vertices.values()))), list(kinds.items()))
    for name, values in vertices.items():
        table[name] = values
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {len(table)}"]
    header += [f"property {'uchar' if kind == 'u1' else 'float'} {name}" for name, kind in kinds.items()]
    content = table.tobytes()
    if triangles is not None:
        faces = np.empty(len(triangles), [("count", "u1"), ("corners", "<i4", 3)])
        faces["count"], faces["corners"] = 3, triangles
        header += [f"element face {len(faces)}", "property list uchar int vertex_indices"]
        content += faces.tobytes()
    return "\n".join([*header, "end_header\n"]).encode("ascii") + content
