"""What stands where in a capture file (schema gs2ci.capture/1), and the empty file that rows are written into.

    /                  attrs: schema, created_utc, run_uid, software, units, name
    /complete          u1 scalar, 0 until the very last write
    /config            text of the settings, attr sha256
    /events            [*] JSON lines: state changes, faults, retries
    /provenance        [S] JSON: name and origin of each row
    /meas              [S, H, W] or [S, H, W, 3], u16 or f4, one chunk per row;
                       attrs offset_dn, scale_dn: shot = (reading - offset_dn) / scale_dn, so that the full scale
                       of one view is 1; saturation_dn: readings at or above it say only «at least» (NaN: none);
                       per_pixel 1: shot = (reading - /calib/dark) / (/calib/flat scale_dn), offset_dn being a mean
    /meas_valid        [S] u1, 1 = this row is whole; written last of a row
    /saturated         [S, H, W] u1, optional: pixels known to be clipped (1) or not (0) otherwise than by
                       saturation_dn; 2 all over: this row brought no map
    /masks/calib       [N, H, W] f4 transmissions in [0, 1]; or u1 with attr full_scale (1 for binary masks, 255
                       for 8-bit ones) where that is the same numbers: transmission = value / full_scale
    /masks/order       [S, N] u2, optional: which of /masks/calib, then [M, H, W], each row was exposed under, in the
                       order of exposure; without it every row was exposed under all of them as they stand
    /masks/bits /masks/contrast                  as shown by the modulator; off/on ratio of each pixel
    /calib/weights     [N] f8, share of its nominal interval during which each mask was exposed
    /calib/{dark,flat,off}[_var] [H, W] f4, /calib/affine [2, 3] f8    optional
    /camera/intrinsics [3, 3] f8, pixels, pixel centres at +0.5, optional; /camera/cfa text, optional
    /camera/distortion [5] f8, OpenCV's k1 k2 p1 p2 k3 beside the intrinsics, optional: none is an ideal pinhole
    /telemetry/world_to_camera   [S, N, 4, 4] f8, optional; a row of NaN: not known for this shot
    /truth/views       [S, N, H, W, C], optional, stored as /masks/calib is; /truth/views_valid [S] u1
    /truth/world_to_camera       [S, N, 4, 4] f8, optional, NaN as above
    /truth/depth       [S, N, H, W] f4, optional: along the optical axis, unit of the poses; 0: not known; NaN as above
    /frames/*          [S] what the sensor and the stage reported with each row

S counts rows (one exposure each), N views. `CaptureHeader` and `FrameRow` are re-exported.
"""

import hashlib
import json
import math
import uuid
from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import Any, Final, Literal

import h5py
import numpy as np
from numpy.typing import NDArray

from gs2ci import __version__
from gs2ci.core.arrays import F32, F64
from gs2ci.core.errors import InputError, StorageError
from gs2ci.core.records import CfaPattern, Shot

SCHEMA: Final = "gs2ci.capture/1"
UNITS: Final = "SI with the unit in the name; lengths of stages in mm; images: full scale of one view = 1"

NO_MAP: Final = 2  # fill value of /saturated

# Static arrays a rig may add: path -> (dtype, number of axes).
CALIBRATION: Final[Mapping[str, tuple[str, int]]] = {
    "masks/bits": ("u1", 3),
    "masks/contrast": ("f4", 2),
    **{f"calib/{name}{tail}": ("f4", 2) for name in ("dark", "flat", "off") for tail in ("", "_var")},
    "calib/affine": ("f8", 2),
}

FRAME_COLUMNS: Final[Mapping[str, str]] = {
    "sequence": "u4",
    "t_kernel_ns": "i8",
    "t_host_ns": "i8",
    "flags": "u4",
    "trigger_index": "i8",
}


@dataclass(frozen=True)
class FrameRow:
    """What the sensor and the stage reported with one reading.

    Args:
        sequence: Frame number given by the sensor's driver; a gap means a lost frame.
        t_kernel_ns: Time stamp of the driver, ns on its own monotonic clock.
        t_host_ns: Time of arrival in our process, ns since the epoch.
        flags: Driver's status bits of the buffer.
        trigger_index: Which trigger of this capture fired the exposure; -1: none.
        stage_pos_mm: Measured stage position at mid-exposure of each view, [N, K] or [K], mm.
        stage_target_mm: Commanded position, same shape.
    """

    sequence: int = 0
    t_kernel_ns: int = 0
    t_host_ns: int = 0
    flags: int = 0
    trigger_index: int = -1
    stage_pos_mm: F64 | None = None
    stage_target_mm: F64 | None = None


@dataclass(frozen=True)
class CaptureHeader:
    """Everything about a capture that is known before its first row.

    Args:
        rows: How many exposures the file has room for, S.
        channels: 3 for RGB readings, 1 for mono or a colour mosaic.
        masks: Transmissions, [N, H, W] float32 in [0, 1], in the order of exposure; [M, H, W] where rows bring their
            own order, M at most 65536.
        weights: Share of its interval during which each mask was exposed, [N] float32.
        reading: "u2" for raw camera counts (DN), "f4" for measurements already in another unit.
        offset_dn: Reading without light, DN.
        scale_dn: Reading of one fully open view at full scale above the offset, DN.
        saturation_dn: Readings at or above it are clipped, DN; None: none is.
        per_pixel: Whether `calib/dark` (DN) and `calib/flat` (sensitivity over its mean) in `calibration` are to be
            used on reading the shots, instead of `offset_dn` and of 1.
        cfa: Colour filter array of single-channel readings.
        intrinsics: Camera matrix, [3, 3], pixels.
        distortion: The lens's coefficients, [5], as in `Shot`.
        stage_axes: How many coordinates a stage position has, K; 0: no stage.
        telemetry: Whether rows bring the stage's poses.
        truth_views: How true views are stored: "" none, "f4", or "u1" (multiples of 1/255).
        truth_poses: Whether rows bring true poses.
        truth_depth: Whether rows bring true depth.
        mask_order: Whether rows bring the order of their masks.
        saturated_map: Whether rows bring their own map of clipped pixels.
        calibration: Further static arrays; keys and dtypes as in `CALIBRATION`.
        name: For reports.
        config: Text of the settings the capture ran with, kept verbatim with its sha256.
    """

    rows: int
    channels: Literal[1, 3]
    masks: F32
    weights: F32
    reading: Literal["u2", "f4"] = "u2"
    offset_dn: float = 0.0
    scale_dn: float = 1.0
    saturation_dn: float | None = None
    per_pixel: bool = False
    cfa: CfaPattern | None = None
    intrinsics: F64 | None = None
    distortion: F64 | None = None
    stage_axes: int = 0
    telemetry: bool = False
    truth_views: Literal["", "f4", "u1"] = ""
    truth_poses: bool = False
    truth_depth: bool = False
    mask_order: bool = False
    saturated_map: bool = False
    calibration: Mapping[str, NDArray[Any]] = field(default_factory=dict)
    name: str = "shot"
    config: str = ""

    def check(self) -> "CaptureHeader":
        """Return self if a file can be laid out from it.

        Raises:
            InputError: Masks, weights, filter array, intrinsics or distortion that no shot could have.
            StorageError: No rows, a scale that is not positive, or an unknown calibration array.
        """
        self.blank_shot().check()
        if self.rows < 1:
            raise StorageError(f"a capture of {self.rows} rows", allowed="at least one", remedy="capture something")
        if not (np.isfinite(self.scale_dn) and self.scale_dn > 0 and np.isfinite(self.offset_dn)):
            raise StorageError(
                f"offset_dn = {self.offset_dn}, scale_dn = {self.scale_dn}",
                allowed="a finite offset and a positive scale",
                remedy="take both from the sensor's dark and flat frames",
            )
        if self.per_pixel and not usable_per_pixel(self.calibration, self.masks.shape[1:]):
            raise StorageError(
                "per-pixel dark and flat are announced and cannot be used",
                allowed="calib/dark finite and calib/flat above 0, both [H, W]",
                remedy="give the pixels that are dead a flat of 1 and mark them as saturated",
            )
        for key, array in self.calibration.items():
            if key not in CALIBRATION or array.ndim != CALIBRATION[key][1]:
                raise StorageError(
                    f"calibration array {key!r} with shape {list(array.shape)}",
                    allowed=", ".join(f"{k} ({d[1]} axes)" for k, d in CALIBRATION.items()),
                    remedy="drop it or rename it",
                )
        return self

    def blank_shot(self) -> Shot:
        """Make a dark shot with this header, so that what fits together is checked in one place."""
        height, width = self.masks.shape[1:] if self.masks.ndim == 3 else (1, 1)
        dark = np.zeros((height, width, self.channels), np.float32)
        masks = self.masks[: len(self.weights)] if self.mask_order else self.masks
        return Shot(dark, masks, self.weights, cfa=self.cfa, intrinsics=self.intrinsics, distortion=self.distortion)

    @property
    def views(self) -> int:
        """Get the number of views of one exposure, N."""
        return len(self.weights)

    @property
    def row_shape(self) -> tuple[int, ...]:
        """Get the shape of one reading as stored: [H, W], or [H, W, 3]."""
        height, width = self.masks.shape[1:]
        return (height, width, 3) if self.channels == 3 else (height, width)

    @property
    def row_bytes(self) -> int:
        """Get how much one reading takes on the disk."""
        return math.prod(self.row_shape) * np.dtype(self.reading).itemsize

    @property
    def static_bytes(self) -> int:
        """Get how much masks and calibration take at most; grey masks shrink to a byte, and packing shrinks more."""
        return self.masks.nbytes + sum(array.nbytes for array in self.calibration.values())


def usable_per_pixel(calibration: Mapping[str, NDArray[Any] | None], size: tuple[int, ...]) -> bool:
    """Tell whether dark and flat are there for every pixel and can be subtracted and divided by."""
    dark, flat = calibration.get("calib/dark"), calibration.get("calib/flat")
    if dark is None or flat is None or dark.shape != size or flat.shape != size:
        return False
    return bool(np.isfinite(dark).all() and np.isfinite(flat).all() and (flat > 0).all())


def create(file: h5py.File, header: CaptureHeader) -> None:
    """Lay out every group, dataset and attribute, with no row in it and `/complete` = 0.

    Everything exists before the first row, so that a crash can only ever lose unfinished rows.
    """
    file.create_dataset("complete", data=np.uint8(0))
    file.attrs["schema"] = SCHEMA
    file.attrs["created_utc"] = datetime.now(UTC).isoformat(timespec="seconds")
    file.attrs["run_uid"] = str(uuid.uuid4())
    file.attrs["software"] = f"gs2ci {__version__}"
    file.attrs["units"] = UNITS
    # A file name that is not UTF-8 has lone surrogates in Python, which HDF5's texts cannot hold.
    file.attrs["name"] = header.name.encode("utf-8", "backslashreplace").decode()
    config = file.create_dataset("config", data=header.config, dtype=h5py.string_dtype())
    config.attrs["sha256"] = hashlib.sha256(header.config.encode()).hexdigest()
    file.create_dataset("events", (0,), h5py.string_dtype(), maxshape=(None,), chunks=(256,))
    file.create_dataset("provenance", (header.rows,), h5py.string_dtype())
    _create_static(file, header)
    _create_rows(file, header)


def _create_static(file: h5py.File, header: CaptureHeader) -> None:
    stored, full_scale = pack(header.masks)
    masks = file.create_dataset("masks/calib", data=stored, chunks=(1, *stored.shape[1:]), **_packing())
    masks.attrs["full_scale"] = full_scale
    file.create_dataset("calib/weights", data=header.weights.astype(np.float64))
    if header.intrinsics is not None:
        file.create_dataset("camera/intrinsics", data=header.intrinsics.astype(np.float64))
    if header.distortion is not None:
        file.create_dataset("camera/distortion", data=header.distortion.astype(np.float64))
    if header.cfa is not None:
        file.create_dataset("camera/cfa", data=header.cfa, dtype=h5py.string_dtype())
    for key, array in header.calibration.items():
        file.create_dataset(key, data=array.astype(CALIBRATION[key][0]))


def _create_rows(file: h5py.File, header: CaptureHeader) -> None:
    rows, views, (height, width) = header.rows, header.views, header.masks.shape[1:]
    # Readings stay uncompressed: noise does not shrink, and a rig has no time to try. Checksums are cheap.
    meas = file.create_dataset(
        "meas", (rows, *header.row_shape), header.reading, chunks=(1, *header.row_shape), fletcher32=True
    )
    meas.attrs["offset_dn"] = float(header.offset_dn)
    meas.attrs["scale_dn"] = float(header.scale_dn)
    meas.attrs["saturation_dn"] = float("nan") if header.saturation_dn is None else float(header.saturation_dn)
    meas.attrs["per_pixel"] = int(header.per_pixel)
    file.create_dataset("meas_valid", (rows,), "u1")
    if header.mask_order:
        file.create_dataset("masks/order", (rows, views), "u2")
    if header.saturated_map:
        shape = (rows, height, width)
        file.create_dataset("saturated", shape, "u1", chunks=(1, *shape[1:]), fillvalue=NO_MAP, **_packing())
    poses = (rows, views, 4, 4)
    if header.telemetry:
        file.create_dataset("telemetry/world_to_camera", poses, "f8", fillvalue=np.nan)
    if header.truth_poses:
        file.create_dataset("truth/world_to_camera", poses, "f8", fillvalue=np.nan)
    if header.truth_depth:
        maps = (rows, views, height, width)
        file.create_dataset("truth/depth", maps, "f4", chunks=(1, 1, *maps[2:]), fillvalue=np.nan, **_packing())
    if header.truth_views:
        channels = 3 if header.cfa else header.channels
        stack = (rows, views, height, width, channels)
        truth = file.create_dataset("truth/views", stack, header.truth_views, chunks=(1, 1, *stack[2:]), **_packing())
        truth.attrs["full_scale"] = 255.0 if header.truth_views == "u1" else 1.0
        file.create_dataset("truth/views_valid", (rows,), "u1")
    for column, dtype in FRAME_COLUMNS.items():
        file.create_dataset(f"frames/{column}", (rows,), dtype)
    if header.stage_axes:
        for column in ("stage_pos", "stage_target"):
            shape_mm = (rows, views, header.stage_axes)
            file.create_dataset(f"frames/{column}", shape_mm, "f8", fillvalue=np.nan).attrs["unit"] = "mm"


def _packing() -> dict[str, Any]:
    return {"compression": "gzip", "compression_opts": 4, "shuffle": True, "fletcher32": True}


def pack(values: F32) -> tuple[NDArray[Any], float]:
    """Turn numbers in [0, 1] into bytes where that loses nothing.

    Returns:
        The array to store and its full scale: value = stored / full_scale, in float32, bit for bit.
    """
    for full_scale in (1.0, 255.0):
        if fits_bytes(values, full_scale):
            return np.rint(values * np.float32(full_scale)).astype(np.uint8), full_scale
    return values, 1.0


def fits_bytes(values: F32, full_scale: float = 255.0) -> bool:
    """Tell whether every number is a whole multiple of 1 / full_scale in [0, 1]."""
    if not (values.min() >= 0 and values.max() <= 1):
        return False
    return np.array_equal(unpack(np.rint(values * np.float32(full_scale)).astype(np.uint8), full_scale), values)


def unpack(stored: NDArray[Any], full_scale: float) -> F32:
    """Turn stored masks or views, of any shape, back into float32 numbers with full scale 1."""
    if full_scale == 1.0:
        return stored.astype(np.float32)
    return stored.astype(np.float32) / np.float32(full_scale)


def to_json(value: object, what: str) -> str:
    """Write a record as one line of JSON.

    Raises:
        InputError: It holds something that JSON has no word for.
    """
    try:
        return json.dumps(value, default=_plain, allow_nan=False)
    except (TypeError, ValueError) as error:
        raise InputError(
            f"{what} cannot be written as JSON: {error}",
            allowed="texts, finite numbers, lists and dictionaries of these",
            remedy="convert it to text first",
        ) from error


def _plain(value: object) -> object:
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, np.ndarray):
        return value.tolist()
    raise TypeError(f"{type(value).__name__} is not known to JSON")
