"""Networks that map a measurement and its masks to views, from ONNX files, run by ONNX Runtime on the CPU.

Here: the supported signature, the shots that a network accepts, and an error for every way in which a file or its
output can be wrong. Not here: any network. The signature is that of EfficientSCI and STFormer (Wang et al. 2023, 2022),
as their programs (github.com/ucaswangls) call a network in `tools/test.py`. `tests/benchmarks/small_network.py` trains
a tiny one on the simulator.

A model takes, in this order and float32,

    y      [1, 1, H, W]  the measurement, Σ wᵢ Mᵢ ⊙ Xᵢ, not normalised: a white scene under m open masks reads m
    Φ      [1, N, H, W]  the masks times their weights
    Φ_s    [1, 1, H, W]  their sum, 1 where it is 0; may be missing

and returns first the views in the full scale of one view: [1, N, H, W] from a grey network, [1, 3, N, H, W] from one
for colour, which takes a mosaic whose first row begins R G.

A grey network is run for each colour of a colour measurement, and for each of the four lattices of a mosaic, whose
views are then demosaicked. Sides may be open, and are then padded to a multiple of 8, or fixed.
"""

from pathlib import Path
from typing import Any, Final

import numpy as np

from gs2ci.core.arrays import F32
from gs2ci.core.errors import InputError, NumericsError
from gs2ci.core.records import Shot
from gs2ci.reconstruct.decode.demosaic import Demosaicer
from gs2ci.reconstruct.learned.onnx_models import SIDE_MULTIPLE, fixed_side, open_model, run_model, signature
from gs2ci.reconstruct.measurement.coding import cfa_channels

_RANK: Final = 4
# Axes (rows, columns) whose reversal makes a mosaic start with R G.
_FLIPS: Final[dict[str, tuple[int, ...]]] = {"RGGB": (), "GRBG": (1,), "GBRG": (0,), "BGGR": (0, 1)}
_CALLED: Final = "y [1, 1, H, W], masks [1, N, H, W] and, if at all, their sum [1, 1, H, W], float32"
_REMEDY: Final = "wrap the network so that it has this signature, and export it again"


class OnnxVideoDecoder:
    """A decoder in an ONNX file.

    Args:
        path: The file.

    Raises:
        InputError: No such file, a file that ONNX Runtime refuses, or inputs and outputs other than a decoder's.
    """

    def __init__(self, path: Path) -> None:
        self.path = Path(path)
        self._session = open_model(self.path, "`python -m tests.benchmarks.small_network FILE` trains a tiny one")
        inputs, outputs = self._session.get_inputs(), self._session.get_outputs()
        ranks = [len(one.shape) for one in inputs]
        if len(inputs) not in (2, 3) or set(ranks) != {_RANK} or any(one.type != "tensor(float)" for one in inputs):
            raise self._refusal()
        if fixed_side(inputs[0].shape[1]) not in (None, 1) or not outputs or len(outputs[0].shape) not in (4, 5):
            raise self._refusal()
        self._inputs = inputs
        self._colour = len(outputs[0].shape) == 5

    def __call__(self, shot: Shot) -> F32:
        """Decode a shot into views, [N, H, W, C] float32, not clamped; C is 3 with a colour filter array.

        Raises:
            InputError: The model is for another number of masks or size, or for colour and the shot is no mosaic of
                even sides.
            NumericsError: The model failed, or returned another shape, NaN or infinity.
        """
        masks = (shot.masks * shot.weights[:, None, None]).astype(np.float32)
        if self._colour:
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
        count = fixed_side(self._inputs[1].shape[1])
        sides = [fixed_side(side) for side in self._inputs[1].shape[2:]]
        if count not in (None, len(masks)) or any(
            s not in (None, had) for s, had in zip(sides, (height, width), strict=True)
        ):
            raise InputError(
                f"{self.path.name} takes {count or 'any number of'} masks of {sides[0] or 'any'} x "
                f"{sides[1] or 'any'} px, not {len(masks)} of {height} x {width}",
                remedy="export the model with open axes, or crop the measurement",
            )
        rows, columns = (0 if s else -had % SIDE_MULTIPLE for s, had in zip(sides, (height, width), strict=True))
        # Mirrored about the last pixel, which keeps the pattern of a mosaic.
        around = ((0, 0), (0, 0), (0, rows), (0, columns))
        y, phi = (np.pad(one, around, mode="reflect") for one in (measurement[None, None], masks[None]))
        total = phi.sum(axis=1, keepdims=True)
        fed: list[F32] = [y, phi, np.where(total == 0, np.float32(1), total)]
        feed: dict[str, Any] = {
            one.name: np.ascontiguousarray(value, np.float32) for one, value in zip(self._inputs, fed, strict=False)
        }
        first = self._session.get_outputs()[0].name
        views = run_model(self._session, self.path.name, feed, "check the model with its own measurements")[first]
        wanted = (*leading, height + rows, width + columns)
        if views.shape != wanted:
            raise NumericsError(f"{self.path.name} made {list(views.shape)}", allowed=f"views {list(wanted)}")
        if not np.isfinite(views).all():
            raise NumericsError(
                f"{self.path.name} returned numbers that are not finite",
                remedy="check that the model takes measurements that are not normalised",
            )
        return views[..., :height, :width].astype(np.float32, copy=False)

    def _refusal(self) -> InputError:
        return InputError(
            f"{self.path} is not a decoder of measurements: it takes {signature(self._session)}",
            allowed=_CALLED,
            remedy=_REMEDY,
        )
