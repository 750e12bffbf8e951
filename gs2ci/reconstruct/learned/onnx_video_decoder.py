"""Networks that map a measurement and its masks to views, from ONNX files, run by ONNX Runtime on the CPU.

Here: the supported signature, and the shots that a network accepts. Not here: any network. The signature is that of
EfficientSCI and STFormer (Wang et al. 2023, 2022), as their programs (github.com/ucaswangls) call a network in
`tools/test.py`. `tests/benchmarks/small_network.py` trains a tiny one on the simulator.

A model takes, in this order and float32,

    y      [1, 1, H, W]  the measurement, Σ wᵢ Mᵢ ⊙ Xᵢ, not normalised: a white scene under m open masks reads m
    Φ      [1, N, H, W]  the masks times their weights
    Φ_s    [1, 1, H, W]  their sum, 1 where it is 0; may be missing

and returns first the views in the full scale of one view: [1, N, H, W] from a grey network, [1, 3, N, H, W] from one
for colour, which takes a mosaic whose first row begins R G.

A grey network is run for each colour of a colour measurement, and for each of the four lattices of a mosaic, whose
views are then demosaicked. Sides may be open, and are then padded to a multiple of 8, or fixed.
"""

from typing import Final

import numpy as np

from gs2ci.core.arrays import F32
from gs2ci.core.errors import InputError
from gs2ci.core.records import Shot
from gs2ci.reconstruct.decode.demosaic import Demosaicer
from gs2ci.reconstruct.learned.onnx_models import OnnxModel, fixed_side
from gs2ci.reconstruct.measurement.coding import cfa_channels

# Axes (rows, columns) whose reversal makes a mosaic start with R G.
_FLIPS: Final[dict[str, tuple[int, ...]]] = {"RGGB": (), "GRBG": (1,), "GBRG": (0,), "BGGR": (0, 1)}


class OnnxVideoDecoder(OnnxModel):
    """A decoder in an ONNX file; see `OnnxModel`."""

    kind = "a decoder of measurements"
    called = "y [1, 1, H, W], masks [1, N, H, W] and, if at all, their sum [1, 1, H, W], float32"
    missing = "`python -m tests.benchmarks.small_network FILE` trains a tiny one"
    of = "measurements"
    makes = "views"
    scaled = "check that the model takes measurements that are not normalised"

    def is_one(self) -> bool:
        """Tell by inputs and outputs whether the file is of this kind."""
        if self.ranks not in ([4] * 2, [4] * 3) or fixed_side(self.inputs[0].shape[1]) not in (None, 1):
            return False
        return len(self.outputs[0].shape) in (4, 5)

    def __call__(self, shot: Shot) -> F32:
        """Decode a shot into views, [N, H, W, C] float32, not clamped; C is 3 with a colour filter array.

        Raises:
            InputError: The model is for another number of masks or size, or for colour and the shot is no mosaic of
                even sides.
            NumericsError: The model failed, or returned another shape, NaN or infinity.
        """
        masks = shot.transmissions
        if len(self.outputs[0].shape) == 5:
            return self._colour_views(shot, masks)
        if shot.cfa is None:
            planes = [self._grey(shot.measurement[..., c], masks) for c in range(shot.measurement.shape[2])]
            return np.stack(planes, axis=-1)
        if any(side % 2 for side in shot.size):
            raise InputError(f"a mosaic of {shot.size[0]} x {shot.size[1]} px", allowed="even sides")
        mosaics = np.empty((shot.views, *shot.size), np.float32)
        for row, column in np.ndindex(2, 2):
            lattice = np.s_[row::2, column::2]
            of_all = (slice(None), *lattice)
            mosaics[of_all] = self._grey(shot.measurement[..., 0][lattice], masks[of_all])
        demosaic = Demosaicer(cfa_channels(shot.cfa, shot.size).numpy())
        return np.stack([demosaic(view).transpose(1, 2, 0) for view in mosaics]).astype(np.float32)

    def _colour_views(self, shot: Shot, masks: F32) -> F32:
        if shot.cfa is None or any(side % 2 for side in shot.size):
            kind = "no mosaic" if shot.cfa is None else f"a mosaic of {shot.size[0]} x {shot.size[1]} px"
            raise InputError(
                f"{self.path.name} decodes mosaics in colour; {shot.name or 'the shot'} is {kind}",
                allowed="a measurement behind a colour filter array, of even sides",
                remedy="take a grey network",
            )
        flips = _FLIPS[shot.cfa]
        turned = np.flip(shot.measurement[..., 0], flips), np.flip(masks, tuple(axis + 1 for axis in flips))
        views = self._run(*turned, (1, 3, shot.views))[0]
        return np.ascontiguousarray(np.flip(views, tuple(axis + 2 for axis in flips)).transpose(1, 2, 3, 0))

    def _grey(self, measurement: F32, masks: F32) -> F32:
        return self._run(measurement, masks, (1, len(masks)))[0]

    def _run(self, measurement: F32, masks: F32, leading: tuple[int, ...]) -> F32:
        """Run the network on y [H, W] and Φ [N, H, W]; returns [*leading, H, W]."""
        height, width = measurement.shape
        count, *sides = (fixed_side(side) for side in self.inputs[1].shape[1:])
        fixed = zip((count, *sides), masks.shape, strict=True)
        if any(side not in (None, had) for side, had in fixed):
            raise InputError(
                f"{self.path.name} takes {count or 'any number of'} masks of {sides[0] or 'any'} x "
                f"{sides[1] or 'any'} px, not {len(masks)} of {height} x {width}",
                remedy="export the model with open axes, or crop the measurement",
            )
        # Mirrored about the last pixel, which keeps the pattern of a mosaic.
        y, phi = (self.padded(one[None], self.inputs[1], "reflect") for one in (measurement[None], masks))
        total = phi.sum(axis=1, keepdims=True)
        views = self.answer((y, phi, np.where(total == 0, np.float32(1), total)), (*leading, *y.shape[2:]))
        return views[..., :height, :width]
