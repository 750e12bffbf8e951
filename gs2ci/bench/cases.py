"""The measurements that tables are made of, each said in a few words that can travel to another process.

Here: `Case` and how it becomes a shot. Not here: the reconstruction (`works`), which cases a table uses (`tables`).
For this package.

A case is either a file of a coded measurement or a scene of the simulator's library. A simulated one is exposed by the
planned light path of `gs2ci_sims`, never by the solver's forward model. A file with true views may be coded anew with
other masks, as the tables of the literature are made; noise is then added to the sum.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from gs2ci.core.errors import InputError
from gs2ci.core.foreign.assemble import ImportOptions, import_shots
from gs2ci.core.records import F32, Shot, Truth
from gs2ci_sims.effects.motion_blur import MotionBlur
from gs2ci_sims.exposure import expose
from gs2ci_sims.light_path import sensor_effects
from gs2ci_sims.masks import random_masks
from gs2ci_sims.planner import plan
from gs2ci_sims.rig import Light, Modulator, Rig
from gs2ci_sims.scenes.files import load_scene

# A tenth of the shot noise at half of full scale with the default sensor: more accuracy would not be seen.
TOLERANCE_DN: Final = 1.0


@dataclass(frozen=True)
class Case:
    """One measurement.

    Args:
        name: In tables.
        file: An .npz, .npy or .mat file; "" for a simulated scene.
        scene: Name of a scene of the simulator's library; "" for a file.
        size: Height and width of a simulated measurement, px.
        views: How many masks; None leaves a file's or scene's own number. A file's true views are thinned to it.
        open_share: Probability that a mask's pixel is open; None leaves a file's own masks (0.25 for scenes).
        noise: Standard deviation added to a recoded measurement, in full scales of one view.
        full_scale_photons: Light of a simulated scene; None as its file says.
        feature_px: Side of a mask's element, px.
    """

    name: str
    file: str = ""
    scene: str = ""
    size: tuple[int, int] = (192, 256)
    views: int | None = None
    open_share: float | None = None
    noise: float = 0.0
    full_scale_photons: float | None = None
    feature_px: int = 1

    @classmethod
    def of(cls, fields: Mapping[str, Any]) -> "Case":
        """Make a case from its fields as JSON holds them."""
        return cls(**{**fields, "size": tuple(fields["size"])})

    def shot(self, seed: int) -> Shot:
        """Make the measurement; the seed draws masks and noise where they are drawn.

        Raises:
            InputError: Not exactly one of file and scene is named, the file cannot be read, it cannot be recoded, or
                a number is out of range.
        """
        if bool(self.file) == bool(self.scene):
            raise InputError(f"case {self.name!r} names file {self.file!r} and scene {self.scene!r}", allowed="one")
        shot = self._simulated(seed) if self.scene else self._from_file(seed)
        return replace(shot, name=self.name)

    def _simulated(self, seed: int) -> Shot:
        loaded = load_scene(self.scene, size=self.size, views=self.views)
        share = 0.25 if self.open_share is None else self.open_share
        light = loaded.light if self.full_scale_photons is None else Light(self.full_scale_photons)
        rig = Rig(light=light, modulator=Modulator(loaded.views, share, self.feature_px))
        masks = random_masks(loaded.views, self.size, share, np.random.default_rng(seed), feature_px=self.feature_px)
        path = loaded.path(rig.exposure_s)
        moving = loaded.object_motion(rig.exposure_s)
        wanted = [MotionBlur(), *sensor_effects(rig.sensor), *([] if moving is None else [moving])]
        chosen = plan(loaded.scene, path, masks, rig, wanted, tolerance_dn=TOLERANCE_DN, seed=seed)
        return expose(loaded.scene, path, masks, rig, effects=chosen.effects, seed=seed, plan=chosen.record())

    def _from_file(self, seed: int) -> Shot:
        shot = import_shots(Path(self.file), None, ImportOptions()).shots[0]
        if self.views is None and self.open_share is None and self.noise == 0:
            return shot
        return recoded(shot, self.views or shot.views, self.open_share, self.noise, np.random.default_rng(seed))


def recoded(shot: Shot, views: int, open_share: float | None, noise: float, rng: np.random.Generator) -> Shot:
    """Code a shot's true views anew: y = Σ Mᵢ Xᵢ + noise.

    Args:
        shot: With true views, [N, H, W, C].
        views: How many of them, evenly spread over the path, first and last included.
        open_share: Of new random binary masks; None takes the shot's own masks of the same views.
        noise: Standard deviation in full scales of one view.
        rng: Where masks and noise come from.

    Raises:
        InputError: The shot has no true views or fewer than asked for, or the noise is not a finite number >= 0.
    """
    truth = shot.truth.views
    if truth is None:
        raise InputError(f"{shot.name} holds no true views to code anew", remedy="leave its masks as they are")
    if not 1 <= views <= shot.views or not 0 <= noise < np.inf:
        raise InputError(
            f"{views} views of {shot.name} with noise {noise}", allowed=f"1 to {shot.views} views, noise >= 0"
        )
    chosen = np.linspace(0, shot.views - 1, views).round().astype(int)
    masks = shot.masks[chosen] if open_share is None else random_masks(views, shot.size, open_share, rng)
    poses = shot.truth.world_to_camera
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
        truth=Truth(seen, None if poses is None else poses[chosen]),
        provenance={**shot.provenance, "recoded": f"{views} views, {open_share} open, noise {noise}"},
    ).check()
