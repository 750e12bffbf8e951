"""A foreign file in, shots and the list of guesses out.

Here: the order in which everything that the user has not fixed is determined. Not here: what the user may fix
(`options`), the single guesses (the files beside this one), writing (`gs2ci.core.storage`).
"""

from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gs2ci.core.arrays import F32, F64
from gs2ci.core.errors import InputError
from gs2ci.core.foreign import agreement, axes, camera, pixels, roles, scale
from gs2ci.core.foreign.agreement import CodingConvention
from gs2ci.core.foreign.camera_files import HALF_A_PIXEL, CameraFile, is_camera_file, matlab_camera, read_calibration
from gs2ci.core.foreign.colours import COLOURS, one_reading
from gs2ci.core.foreign.container import Array, Container
from gs2ci.core.foreign.fields import Fields
from gs2ci.core.foreign.gathered import Found, chosen_masks, find, weights_of
from gs2ci.core.foreign.opening import load_single, open_foreign
from gs2ci.core.foreign.options import ImportOptions
from gs2ci.core.foreign.overflow import with_sign
from gs2ci.core.foreign.pattern import PatternTrace
from gs2ci.core.foreign.settled import SettledReadings, settle
from gs2ci.core.foreign.stage_log import poses_in, stage_poses
from gs2ci.core.records import CFA_PATTERNS, CfaPattern, Shot, Truth


@dataclass(frozen=True)
class Imported:
    """Shots from one file, and every guess made on the way, one sentence each."""

    shots: list[Shot]
    guesses: list[str]


def import_shots(path: Path, masks_path: Path | None, options: ImportOptions) -> Imported:
    """Turn a foreign file into shots.

    Args:
        path: .npz, .npy, .mat or pictures with the measurement and, unless given apart, its masks.
        masks_path: File or folder with the masks.
        options: What the user knows.

    Raises:
        InputError: The file cannot be understood or contradicts itself; names file, key and remedy.
    """
    guesses: list[str] = []
    if options.stage is not None:
        options = replace(options, telemetry=stage_poses(options.stage, options.stage_axes, guesses))
    found = find(path, masks_path, options, guesses)
    own = axes.own_masks(found.measurement, found.masks)
    if own is None:
        if (pages := found.container.pages) == COLOURS and options.meas_layout == "auto":
            options = replace(options, meas_layout="stack")
            told = "pictures are as many measurements; if they are the colours of one, say --meas-layout rgb"
            guesses.append(f"{found.measurement.where}: {pages} {told}")
        shots = _shots(path.stem, found, options, guesses)
    else:
        guesses.append(f"{len(own)} exposures, each with masks of its own")
        shots = []
        truths = _truths(found.truth, own)
        for k, ((measurement, masks), truth) in enumerate(zip(own, truths, strict=True)):
            one = replace(found, measurement=measurement, masks=masks, truth=truth, exposure=k, exposures=len(own))
            more: list[str] = []
            shots += _shots(f"{path.stem}-{k}", one, options, more)
            guesses += [f"exposure {k}: {guess}" for guess in more]
    for holder in {id(one): one for one in (found.container, found.masks_container)}.values():
        if unused := holder.unused():
            guesses.append(f"{holder.path}: not used: {unused}")
    return Imported(shots, guesses)


def _check_guess(found: Found, options: ImportOptions, traced: PatternTrace | None) -> None:
    """Refuse what only its lonely name made the measurement if it shows no masks: benchmarks hold true views alone."""
    is_named = options.meas_key or roles.key_of(found.container, "measurement", None, [])
    if is_named or "" in found.container.entries or traced is None or traced.shows:
        return
    raise InputError(
        f"{found.measurement.where}: has no known name, and shows no trace of the masks: views that nothing coded, or "
        "another's masks?",
        allowed=f"a measurement, the sum of masked views, under one of {', '.join(roles.ALIASES['measurement'])}",
        remedy=f"name it with --meas-key if it is one; true views become one by {roles.CODED}",
    )


def _truths(truth: Array | None, own: list[tuple[Array, Array]]) -> list[Array | None]:
    """Return the true views of each of several exposures, [N, H, W, C], whichever axis of the file counts them."""
    if truth is None:
        return [None] * len(own)
    views, *size = own[0][1].values.shape
    arranged = axes.arrange_truth(truth, len(own), views, (size[0], size[1]))
    return [Array(truth.where, one) for one in arranged]


def _shots(name: str, found: Found, options: ImportOptions, guesses: list[str]) -> list[Shot]:
    """Turn the arrays of a file into shots that share their masks."""
    order = axes.arrange(found.measurement, found.masks, found.truth, options, guesses)
    measurements, mosaic, reduced = one_reading(order.measurements)
    # A grey scene of a colour sensor has equal channels, too: its true views say that it has three.
    is_grey_in_colour = mosaic is None and found.truth is not None and found.truth.values.shape[-1:] == (COLOURS,)
    if reduced and not is_grey_in_colour:
        guesses.append(f"{found.measurement.where}: {reduced}")
        order = replace(order, measurements=measurements)
        options = replace(options, cfa=options.cfa or mosaic)
    fields = Fields.of(found.container, options, order.measurements.shape[1:], guesses)
    stack = fields.without_dark(chosen_masks(order.masks, found, options), found.masks.where, guesses)
    masks = scale.scale_masks(found.masks, stack, options.mask_scale, guesses)
    coding = CodingConvention(masks, weights_of(found, len(order.masks), len(masks), guesses))
    coding = coding.reversed() if options.reverse_masks else coding
    stored = with_sign(found.measurement.where, order.measurements, guesses).astype(np.float64)
    offset = options.offset or 0.0
    stored = pixels.mend(found.measurement, stored, offset, coding.multiplicity, options.bad_pixels, guesses)
    is_mosaic = options.cfa is not None or roles.key_of(found.container, "cfa", None, []) is not None
    without = pixels.lit(found.measurement, stored - (offset + fields.black), guesses)
    settled = settle(
        *(found.measurement, found.masks, options, coding, without),
        is_mosaic=is_mosaic,
        has_dark=fields.dark is not None,
        guesses=guesses,
    )
    _check_guess(found, options, settled.traced)
    # A sum that went round or was divided has no highest reading; a curve has one.
    counted = settled.readings + offset + fields.black if settled.undone in ("overflow", "divided") else stored
    settled = replace(settled, readings=fields.flattened(settled.readings, stack, guesses))
    work = _Import(found, options, settled, guesses)
    coding = settled.coding
    views = work.true_views()
    cfa = work.colour_filter_array(views)
    full = work.full_scale(views, cfa, settled.traced)
    saturated = pixels.clipped(counted, options.saturation, coding.multiplicity, guesses)
    matrix = work.intrinsics()
    lens = work.distortion(matrix)
    true_poses, telemetry = work.true_poses(), work.telemetry()
    return [
        Shot(
            measurement=(reading / full.value).astype(np.float32),
            masks=coding.masks,
            weights=coding.weights,
            cfa=cfa,
            intrinsics=matrix,
            distortion=lens,
            truth=Truth(_part(views, k), _part(true_poses, k)),
            telemetry_world_to_camera=_part(telemetry, k),
            saturated=_part(saturated, k),
            name=name if len(stored) == 1 else f"{name}-{k}",
            provenance=work.provenance(k, full),
        ).check()
        for k, reading in enumerate(work.readings)
    ]


def _part(stack: NDArray[Any] | None, index: int) -> Any:
    return None if stack is None else stack[index]


@dataclass(frozen=True)
class _Import:
    """One import under way.

    Args:
        found: Arrays by role.
        options: What the user knows.
        settled: Masks and readings.
        guesses: Sentences so far.
    """

    found: Found
    options: ImportOptions
    settled: SettledReadings
    guesses: list[str]

    @property
    def coding(self) -> CodingConvention:
        """Get masks and weights."""
        return self.settled.coding

    @property
    def readings(self) -> F64:
        """Get the readings above the offset, [K, H, W, C]."""
        return self.settled.readings

    def true_views(self) -> F32 | None:
        """Get the true views, [K, N, H, W, C], full scale 1."""
        truth = self.found.truth
        if truth is None:
            return None
        height, width = self.readings.shape[1:3]
        arranged = axes.arrange_truth(truth, len(self.readings), len(self.coding.masks), (height, width))
        return scale.scale_views(truth, arranged, self.guesses)

    def colour_filter_array(self, views: F32 | None) -> CfaPattern | None:
        """Get the filter array: said, written in the file, or found through the truth."""
        container, channels = self.found.container, self.readings.shape[3]
        said: str | None = self.options.cfa
        where, key = "--cfa", None
        if said is None:
            key = roles.key_of(container, "cfa", None, self.guesses)
        if key is not None:
            where, said = container.where(key), container.text(key).upper()
        cfa = next((pattern for pattern in CFA_PATTERNS if pattern == said), None)
        if said is not None and (cfa is None or channels != 1):
            raise InputError(
                f"{where}: colour filter array {said!r} for a measurement with {channels} channel(s)",
                allowed=f"one of {', '.join(CFA_PATTERNS)}, for a single-channel measurement",
                remedy="leave it out for RGB and mono measurements",
            )
        if key is not None:
            self.guesses.append(f"{where}: colour filter array {cfa}")
        if cfa is None and channels == 1 and views is not None and views.shape[4] == 3:
            cfa = agreement.guess_cfa(self.readings[0], self.coding, views[0], self.guesses)
        if channels == 1:
            agreement.doubt_mosaic(self.readings[0, :, :, 0], self.coding, cfa, self.guesses)
        self._check_truth_channels(views, 3 if cfa else channels)
        return cfa

    def _check_truth_channels(self, views: F32 | None, channels: int) -> None:
        if views is None or self.found.truth is None or views.shape[4] == channels:
            return
        raise InputError(
            f"{self.found.truth.where}: true views with {views.shape[4]} channel(s), "
            f"but the measurement gives views with {channels}",
            allowed=f"views with {channels} channel(s)",
            remedy="name the filter array of a mosaic with --cfa, or leave the truth out with --truth-key none",
        )

    def full_scale(self, views: F32 | None, cfa: CfaPattern | None, traced: PatternTrace | None) -> scale.Scale:
        """Get the reading of a white scene under one open mask: said, from the truth, or guessed.

        Where the masks' pattern shows elsewhere, the scale is that under masks that lie there; and readings that no
        scale explains are passed on to registration.
        """
        said, truth, proven = self.options.scale, self.found.truth, None
        if views is not None and truth is not None:
            proven = agreement.check_truth(truth, self.readings[0], self.coding, views[0], cfa, guesses=self.guesses)
        if said is None:
            chosen = proven or scale.guess_scale(
                self.found.measurement,
                self.readings,
                self.coding.multiplicity if traced is None else traced.moved(self.coding.multiplicity),
                len(self.coding.masks),
                mendable=traced is not None and traced.can_be_mended,
            )
            doubt = "" if chosen.explains else "WARNING: "
            self.guesses.append(f"{doubt}measurement: full scale of one view = {chosen.value:.6g} ({chosen.reason})")
            return chosen
        if not (np.isfinite(said) and said > 0):
            raise InputError(
                f"--scale {said}", allowed="a number > 0, the reading of a white scene under one open mask"
            )
        if proven is not None and abs(proven.value / said - 1) > agreement.SNAP:
            self.guesses.append(f"WARNING: the truth asks for --scale {proven.value:.6g}, not {said:.6g}")
        return scale.Scale(said, "stated", stated=True)

    @cached_property
    def camera_file(self) -> CameraFile | None:
        """Get the camera of a file of another program, if the user names one."""
        given = self.options.intrinsics
        if isinstance(given, Path) and is_camera_file(given):
            return read_calibration(given, self.readings.shape[1:3])
        found = None if self.calibration is None else matlab_camera(self.calibration, self.readings.shape[1:3])
        if found is not None:
            self.guesses.append(
                f"{given}: a camera of MATLAB's, which counts pixels from 1: half of one was subtracted"
            )
        return found

    @cached_property
    def calibration(self) -> Container | None:
        """Get the file of arrays in which the user says that the camera is."""
        given = self.options.intrinsics
        return open_foreign(given) if isinstance(given, Path) and not is_camera_file(given) else None

    def intrinsics(self) -> F64 | None:
        """Get the camera matrix: said, or from the file."""
        given, options = self.options.intrinsics, self.options
        if options.focal_px is not None:
            if given is not None:
                raise InputError("--focal-px and --intrinsics are both given", remedy="give one of them")
            given = Array("--focal-px", np.asarray(options.focal_px))
        if self.camera_file is not None:
            given = Array(str(given), self.camera_file.intrinsics)
        elif isinstance(given, Path):
            given = self._load("intrinsics", self.calibration) or load_single(given)
        given = given or self._load("intrinsics") or self._load("focal")
        if given is None:
            self.guesses.append("camera: no intrinsics given; the focal length will have to be estimated")
            return None
        return camera.intrinsics_from(given, self.readings.shape[1:3], self.guesses)

    def distortion(self, intrinsics: F64 | None) -> F64 | None:
        """Get the lens's coefficients, [5]: said, or from a file that has the camera matrix as well."""
        given = self.options.distortion
        if given is None and self.camera_file is not None:
            if not self.camera_file.distortion.any():
                return None
            given = Array(str(self.options.intrinsics), self.camera_file.distortion)
        if given is None and self.calibration is not None:
            given = self._load("distortion", self.calibration)
            # OpenCV's documents and ROS call the lens D beside K; in a measurement's file d may be anything.
            if given is None and (key := roles.names_of(self.calibration).get("d")) is not None:
                given = self.calibration.load(key)
            if given is None and (unused := self.calibration.unused()):
                self.guesses.append(f"{self.calibration.path}: no lens under a known name; not used: {unused}")
        given = given or self._load("distortion")
        if given is None:
            return None
        if intrinsics is None and self.options.distortion is None:
            self.guesses.append(f"WARNING: {given.where}: a distortion without a camera matrix was left out")
            return None
        return camera.distortion_from(given, self.guesses)

    def true_poses(self) -> F64 | None:
        """Get the true poses, [K, N, 4, 4], from the user or from the file."""
        given = self.options.world_to_camera
        if isinstance(given, Path):
            given = poses_in(given, self.guesses) or load_single(given, "world_to_camera")
        if given is not None:
            return self._stack_of_poses(self.found.own(given))
        poses = self.poses("world_to_camera")
        return self.poses("camera_to_world") if poses is None else poses

    def telemetry(self) -> F64 | None:
        """Get the poses that a stage reported, [K, N, 4, 4], by its log or from the file."""
        given, shots = self.options.telemetry, len(self.readings)
        if given is None:
            return self.poses("telemetry")
        given = self.found.own(given)
        masks = sorted({self.settled.given, len(self.settled.shown)})
        if len(given.values) not in [shots * one for one in masks]:
            told = " or ".join(str(shots * one) for one in masks)
            raise InputError(
                f"{given.where}: {len(given.values)} positions for {told} masks{f' in {shots} shots' * (shots > 1)}",
                allowed="one for each mask, in the order of exposure",
                remedy="take the positions at the middle of each mask's interval (docs/how-to.md)",
            )
        return self._stack_of_poses(given)

    def poses(self, role: roles.Role) -> F64 | None:
        """Get the poses under a role of the file, [K, N, 4, 4]."""
        given = self._load(role)
        if given is None:
            return None
        self.guesses.append(f"{given.where}: {'poses of the stage' if role == 'telemetry' else 'true poses'}")
        return self._stack_of_poses(self.found.own(given), camera_to_world=role == "camera_to_world")

    def provenance(self, index: int, full: scale.Scale) -> dict[str, Any]:
        """Say where a shot came from and what was guessed."""
        return {
            "source": self.found.container.path.name,
            "measurement": index,
            "full_scale": full.value,
            "unit_stated": full.stated,
            "offset": self.options.offset or 0.0,
            "guesses": list(self.guesses),
            "undone": self.settled.undone,
            "curved": self.settled.curved,
            **self._stated(),
        }

    def _stated(self) -> dict[str, Any]:
        said = self.options
        errors = {"position_error": said.stage_error, "turn_error_deg": said.stage_turn_error_deg}
        stated = {name: error for name, error in errors.items() if error is not None}
        return {"telemetry": stated} if stated else {}

    def _load(self, role: roles.Role, container: Container | None = None) -> Array | None:
        """Load what plays a role in the measurement's file, or in another."""
        holder = container or self.found.container
        key = roles.key_of(holder, role, None, self.guesses)
        if key is None:
            return None
        loaded = holder.load(key)
        if key.lower() not in ("mtx", "kk") or loaded.values.shape != (3, 3):
            return loaded
        self.guesses.append(f"{loaded.where}: half a pixel was added to cx and cy, as OpenCV counts from pixel centres")
        return Array(loaded.where, loaded.values + HALF_A_PIXEL)

    def _stack_of_poses(self, given: Array, *, camera_to_world: bool = False) -> F64:
        shots, chosen, given_masks = len(self.readings), list(self.settled.shown), self.settled.given
        # Poses of all masks of the file, or only of those that were shown.
        counts = [shots * given_masks, shots * len(chosen)]
        count = next((n for n in counts if n in given.values.shape), counts[-1])
        poses = camera.poses_from(given, count, camera_to_world=camera_to_world, guesses=self.guesses)
        poses = poses.reshape(shots, -1, 4, 4)
        return poses[:, chosen] if poses.shape[1] == given_masks else poses
