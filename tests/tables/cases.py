"""The measurements for tables, each described by a few plain values that can be sent to another process.

Here: `Case`, how it becomes a shot, and the true views from beside its path. Not here: the reconstruction
(`works`), which cases there are and a table uses (`case_sets`, `catalogue`).

A case is either a file of a coded measurement or a scene of the simulator's library. A simulated one is exposed by the
planned light path of `gs2ci_sims`, never by the solver's forward model. A file's true views may be coded again with
other masks, as in the tables of the literature. Requested noise comes last: in a simulated scene, in addition to the
noise of light and sensor.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from gs2ci.core.arrays import F32
from gs2ci.core.cameras import camera_centres
from gs2ci.core.crop import middle
from gs2ci.core.errors import InputError
from gs2ci.core.foreign.assemble import import_shots
from gs2ci.core.foreign.options import ImportOptions
from gs2ci.core.records import MEASUREMENT_LIMIT, Shot, Truth
from gs2ci.core.storage import read_shot
from gs2ci_sims.effects.motion_blur import MotionBlur
from gs2ci_sims.light_path import generator, sensor_effects
from gs2ci_sims.masks import random_masks
from gs2ci_sims.planner import plan
from gs2ci_sims.radiance import Renderer
from gs2ci_sims.rig import Light, ModulatorFigures, RigFigures
from gs2ci_sims.scenes.files import load_scene
from gs2ci_sims.simulation_plan import PlanChoice, SimulationTask
from tests.exposing import expose
from tests.sims.grey_masks import random_grey_masks
from tests.tables.beside import BesideViews, beside_file, beside_path, read_beside

# A tenth of the shot noise at half of full scale with the default sensor: more accuracy would not be seen.
TOLERANCE_DN: Final = 1.0
# Of simulated measurements, px, unless another is requested.
SIZE: Final = (192, 256)
# Mean number of open masks at a pixel for which the library's scenes fill the sensor's well: 8 masks, a quarter open.
LIT_FOR_OPEN_MASKS: Final = 2.0


@dataclass(frozen=True)
class Case:
    """One measurement.

    Args:
        name: In tables.
        file: An .npz, .npy, .mat or .h5 file; "" for a simulated scene.
        scene: Name of a scene of the simulator's library; "" for a file.
        size: Height and width, px: those of a simulated measurement (None: `SIZE`), or the middle of a file's, the
            rest cut away (None: all of it).
        views: How many masks; None leaves a file's or scene's own number. A file's true views are thinned to it.
        open_share: Probability that a mask's pixel is open; None leaves a file's own masks (0.25 for scenes).
        noise: Standard deviation of white noise that is added to the measurement, in full scales of one view. A
            file's views are coded again for it; a simulated scene's clipped readings stay as they are.
        grey_masks: Draw masks of every grey between closed and open (`random_grey_masks`), of the same mean:
            `open_share`, or that of a file's own masks.
        weights_off: Error of the measurement's stated weights, as by a lamp that flickers: each is multiplied by a
            factor drawn uniformly from 1 ± this.
        focal_known: Whether the measurement contains its camera matrix; without it the solver estimates one.
        stage_off: Rms error of the camera positions that a stage reports, as a share of the path's extent; directions
            have no error. None reports no poses.
        stopped_down: Reduce the light of a simulated scene with the number of open masks, so that the sensor's well
            is as full as with 8 masks, a quarter open. Otherwise many masks clip many readings.
        full_scale_photons: Light of a simulated scene; None takes its file's.
        feature_px: Side of a mask's element, px.
    """

    name: str
    file: str = ""
    scene: str = ""
    size: tuple[int, int] | None = None
    views: int | None = None
    open_share: float | None = None
    noise: float = 0.0
    grey_masks: bool = False
    weights_off: float = 0.0
    focal_known: bool = True
    stage_off: float | None = None
    stopped_down: bool = False
    full_scale_photons: float | None = None
    feature_px: int = 1

    @classmethod
    def of(cls, fields: Mapping[str, Any]) -> "Case":
        """Make a case from its fields as JSON holds them."""
        size = fields["size"]
        return cls(**{**fields, "size": None if size is None else tuple(size)})

    def shot(self, seed: int) -> Shot:
        """Make the measurement; the seed draws masks and noise where they are drawn.

        Raises:
            InputError: Not exactly one of file and scene is named, the file cannot be read, it cannot be recoded, it
                is smaller than requested, it has no camera matrix to leave out or no true path to report, or a value is
                out of range.
        """
        self._check()
        shot = self._simulated(seed) if self.scene else self._from_file(seed)
        if self.weights_off:
            shot = reweighted(shot, self.weights_off, generator(seed, "weights"))
        if not self.focal_known:
            shot = without_focal(shot)
        if self.stage_off is not None:
            shot = staged(shot, self.stage_off, generator(seed, "stage"))
        return replace(shot, name=self.name)

    @property
    def files(self) -> tuple[str, ...]:
        """Get the paths of the files that it reads."""
        if not self.file:
            return ()
        told = beside_file(self.file)
        return (self.file, str(told)) if told.is_file() else (self.file,)

    def novel_views(self, shot: Shot) -> BesideViews | None:
        """Return the true views beside the path of a shot (`beside_path`), without noise.

        None if they are not known: for a file without such views (`beside`), or with views thinned to another path; if
        something moves by itself; and for a single view.

        Raises:
            InputError: The file of these views cannot be read.
        """
        true = shot.truth.world_to_camera
        if shot.views < 2:
            return None
        if not self.scene:
            return read_beside(self.file, self.size) if self.views is None else None
        if true is None:
            return None
        loaded = load_scene(self.scene, size=self.size or SIZE, views=self.views)
        if loaded.file.object_motion is not None:
            return None
        return BesideViews(Renderer().views(loaded.scene, beside_path(true))[0])

    def _check(self) -> None:
        if bool(self.file) == bool(self.scene):
            raise InputError(f"case {self.name!r} names file {self.file!r} and scene {self.scene!r}", allowed="one")
        check_noise(self.noise)
        if not 0 <= self.weights_off < 1:
            raise InputError(f"case {self.name!r} has weights off by {self.weights_off}", allowed="0 to less than 1")
        if self.stage_off is not None and not 0 <= self.stage_off < 1:
            raise InputError(f"case {self.name!r} has a stage off by {self.stage_off}", allowed="0 to less than 1")
        for switch in ("grey_masks", "focal_known", "stopped_down"):
            value = getattr(self, switch)
            if not isinstance(value, bool):
                raise InputError(f"case {self.name!r} has {switch} = {value!r}", allowed="true or false")

    def _simulated(self, seed: int) -> Shot:
        size = self.size or SIZE
        loaded = load_scene(self.scene, size=size, views=self.views)
        share = 0.25 if self.open_share is None else self.open_share
        photons = loaded.light.full_scale_photons if self.full_scale_photons is None else self.full_scale_photons
        modulator = ModulatorFigures(loaded.views, share, self.feature_px)
        if self.stopped_down:
            photons *= min(1.0, LIT_FOR_OPEN_MASKS / (modulator.masks * modulator.open_share))
        rig = RigFigures(light=Light(photons), modulator=modulator)
        draw = random_grey_masks if self.grey_masks else random_masks
        masks = draw(loaded.views, size, share, np.random.default_rng(seed), feature_px=self.feature_px)
        path = loaded.path(rig.exposure_s)
        moving = loaded.object_motion(rig.exposure_s)
        wanted = [MotionBlur(), *sensor_effects(rig.sensor), *([] if moving is None else [moving])]
        task = SimulationTask(loaded.scene, path, masks, rig, wanted, seed)
        chosen = plan(task, PlanChoice(TOLERANCE_DN))
        shot = expose(loaded.scene, path, masks, rig, effects=chosen.effects, seed=seed, plan=chosen.record())
        return shot if self.noise == 0 else noisy(shot, self.noise, generator(seed, "added noise"))

    def _from_file(self, seed: int) -> Shot:
        file = Path(self.file)
        shot = read_shot(file) if file.suffix == ".h5" else import_shots(file, None, ImportOptions()).shots[0]
        if self.size is not None:
            shot = middle(shot, self.size).check()
        if self.views is None and self.open_share is None and self.noise == 0 and not self.grey_masks:
            return shot
        views, rng = shot.views if self.views is None else self.views, np.random.default_rng(seed)
        return recoded(shot, views, self.open_share, self.noise, rng, grey=self.grey_masks)


def check_noise(noise: float) -> None:
    """Accept a standard deviation in full scales of one view.

    Raises:
        InputError: It is not a number from 0 to what a measurement may reach.
    """
    if not 0 <= noise <= MEASUREMENT_LIMIT:
        raise InputError(f"noise of {noise} full scales of a view", allowed=f"0 to {MEASUREMENT_LIMIT:g}")


def noisy(shot: Shot, noise: float, rng: np.random.Generator) -> Shot:
    """Add white noise to a measurement.

    Clipped readings stay: noise before the clipping would not show in them, and as they are marked they go on
    saying no more than «at least».

    Args:
        shot: Exposed, with noise of its own or without.
        noise: Standard deviation in full scales of one view.
        rng: Where it comes from.

    Raises:
        InputError: The noise is out of range.
    """
    check_noise(noise)
    added = noise * rng.standard_normal(shot.measurement.shape)
    if shot.saturated is not None:
        added[shot.saturated] = 0.0
    measurement = (shot.measurement + added).astype(np.float32)
    return replace(shot, measurement=measurement, provenance={**shot.provenance, "added_noise": noise}).check()


def reweighted(shot: Shot, spread: float, rng: np.random.Generator) -> Shot:
    """Tell weights that are not those of the exposure; their mean stays.

    Args:
        shot: With its own weights.
        spread: Of the factors, drawn evenly from 1 ± this; less than 1.
        rng: Where they come from.
    """
    factors = rng.uniform(1 - spread, 1 + spread, shot.views)
    told = (shot.weights * factors / factors.mean()).astype(np.float32)
    return replace(shot, weights=told, provenance={**shot.provenance, "weights_off": spread}).check()


def without_focal(shot: Shot) -> Shot:
    """Leave out a shot's camera matrix, so that its solver has to find the focal length.

    Raises:
        InputError: There is none: the shot as it is shows what is requested.
    """
    if shot.intrinsics is None:
        raise InputError(
            f"{shot.name} holds no camera matrix to leave out", remedy="look at the line of the case as it is"
        )
    return replace(shot, intrinsics=None, distortion=None)


def staged(shot: Shot, off: float, rng: np.random.Generator) -> Shot:
    """Tell the true path as a stage would that errs in its places.

    Args:
        shot: With true poses.
        off: Error of each place, root mean square, as a share of the path's extent.
        rng: Where the errors come from.

    Raises:
        InputError: The shot has no true poses.
    """
    true = shot.truth.world_to_camera
    if true is None:
        raise InputError(f"{shot.name} holds no true poses for a stage to tell", remedy="leave the stage out")
    centres = camera_centres(true)
    errors = rng.standard_normal(centres.shape) / np.sqrt(3)
    told = true.copy()
    told[:, :3, 3] -= off * np.linalg.norm(np.ptp(centres, axis=0)) * np.einsum("nij,nj->ni", true[:, :3, :3], errors)
    provenance = {**shot.provenance, "stage_off": off}
    return replace(shot, telemetry_world_to_camera=told, provenance=provenance).check()


def recoded(
    shot: Shot, views: int, open_share: float | None, noise: float, rng: np.random.Generator, *, grey: bool = False
) -> Shot:
    """Code a shot's true views again: y = Σ Mᵢ Xᵢ + noise.

    Args:
        shot: With true views, [N, H, W, C].
        views: How many of them, evenly spread over the path, first and last included.
        open_share: Of new random masks; None takes the shot's own masks of the same views.
        noise: Standard deviation in full scales of one view.
        rng: Where masks and noise come from.
        grey: Draw grey masks instead of binary ones, without an `open_share` of the same mean as the shot's own.

    Raises:
        InputError: The shot has no true views or fewer than asked for, or a number is out of range.
    """
    check_noise(noise)
    truth = shot.truth.views
    if truth is None:
        raise InputError(f"{shot.name} holds no true views to code anew", remedy="leave its masks as they are")
    if not 1 <= views <= shot.views:
        raise InputError(f"{views} views of {shot.name}, which holds {shot.views}", allowed=f"1 to {shot.views} views")
    chosen = np.linspace(0, shot.views - 1, views).round().astype(int)
    masks = shot.masks[chosen]
    if grey:
        share = float(masks.mean()) if open_share is None else open_share
        if share == 1:
            raise InputError("grey masks with a mean transmission of 1", allowed="more than 0, less than 1")
        masks = random_grey_masks(views, shot.size, share, rng)
    elif open_share is not None:
        masks = random_masks(views, shot.size, open_share, rng)
    poses, depth = shot.truth.world_to_camera, shot.truth.depth
    seen: F32 = truth[chosen]
    coded = np.einsum("nhw,nhwc->hwc", masks, seen, dtype=np.float64)
    coded += noise * rng.standard_normal(coded.shape)
    return replace(
        shot,
        measurement=coded.astype(np.float32),
        masks=masks,
        weights=np.ones(views, np.float32),
        cfa=None,
        saturated=None,
        telemetry_world_to_camera=None,
        truth=Truth(seen, None if poses is None else poses[chosen], None if depth is None else depth[chosen]),
        provenance={**shot.provenance, "recoded": f"{views} views, {open_share} open, grey {grey}, noise {noise}"},
    ).check()
