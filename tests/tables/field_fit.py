"""A radiance field fitted to one coded measurement together with its camera path, as in SCINeRF (Li et al. 2024).

Here: the fit. Not here: the field and its rendering (`radiance_field`). Random pixels of the measurement are predicted
from the rays of all views through them, Σ wᵢ Mᵢ Xᵢ, and field and poses follow the gradient of the absolute error: the
ℓ1 part of our own fit's loss. SSIM needs a window, which single pixels do not have.

Two things differ from SCINeRF and favour the field: a hash grid instead of a deep network, which needs a few thousand
steps instead of a hundred thousand, and a path that starts from our tracks and not at rest.
"""

from dataclasses import dataclass, field
from typing import Annotated, Final

import numpy as np
import torch
from pydantic import Field, PositiveInt
from torch import Tensor

from gs2ci.core.arrays import F32, F64
from gs2ci.core.bounds import Bounded
from gs2ci.core.config import Positive
from gs2ci.core.errors import InputError, NumericsError
from gs2ci.core.records import Shot
from gs2ci.reconstruct.geometry.initialise import Geometry
from gs2ci.reconstruct.measurement.coding import cfa_channels
from tests.render import se3
from tests.tables.radiance_field import Frustum, RadianceField, cast

# Number of rays rendered at once for whole views.
_RAYS_AT_ONCE: Final = 4096
# Factors by which the frustum exceeds the range of the first depths, which are rough.
_NEARER, _FARTHER = 1.5, 0.5


@dataclass(frozen=True)
class FieldSettings(Bounded):
    """How long and how finely.

    Args:
        iterations: Steps of Adam.
        pixels: Pixels of the measurement in each step; each costs one ray for each view.
        samples: Along a ray.
        rate: Step size of the grid and the networks; it falls to a twentieth.
        pose_rate: Of the poses, in radians and scene units (the median depth is about 1); it falls in the same way.
        poses_from: Share of the iterations after which poses move.
    """

    iterations: PositiveInt = 2500
    pixels: PositiveInt = 192
    samples: PositiveInt = 32
    rate: Positive = 1e-2
    pose_rate: Positive = 5e-4
    poses_from: Annotated[float, Field(ge=0, le=1)] = 0.1


@dataclass(frozen=True)
class FittedField:
    """The result of the fit.

    Args:
        scene: The field.
        world_to_camera: The refined path, [N, 4, 4].
        samples: Along a ray, for rendering.
        loss: Of each step.
    """

    scene: RadianceField
    world_to_camera: F64
    samples: int
    loss: list[float] = field(repr=False)

    def seen(self, world_to_camera: F64) -> tuple[F32, F32]:
        """Render whole views and the depth along the optical axis, [V, H, W, 3] and [V, H, W], from poses [V, 4, 4]."""
        height, width = self.scene.frustum.size
        y, x = np.mgrid[:height, :width] + 0.5
        pixels = torch.from_numpy(np.stack([x.ravel(), y.ravel()], axis=1)).float()
        views, depths = [], []
        with torch.no_grad():
            for pose in torch.from_numpy(world_to_camera).float():
                parts = [
                    cast(self.scene, pose.expand(len(part), 4, 4), part, self.samples)
                    for part in torch.split(pixels, _RAYS_AT_ONCE)
                ]
                views.append(torch.cat([colour for colour, _ in parts]).reshape(height, width, 3).numpy())
                depths.append(1 / torch.cat([inverse for _, inverse in parts]).reshape(height, width).numpy())
        return np.stack(views), np.stack(depths)


def fit_field(
    shot: Shot,
    geometry: Geometry,
    settings: FieldSettings | None = None,
    seed: int = 0,
) -> FittedField:
    """Fit a field to a measurement.

    Args:
        shot: A checked shot: colour, grey or mosaic; taken through a pinhole.
        geometry: First path and depths.
        settings: How long and how finely.
        seed: Of all draws.

    Raises:
        InputError: The settings make no sense, or the shot was taken through a lens that distorts.
        NumericsError: The loss is not finite.
    """
    settings = (settings or FieldSettings()).check()
    if shot.distortion is not None and np.any(shot.distortion):
        raise InputError("a radiance field behind a lens that distorts", remedy="straighten the measurement first")
    generator = torch.Generator().manual_seed(seed)
    near, far = np.quantile(geometry.inverse_depth, 0.99), np.quantile(geometry.inverse_depth, 0.01)
    frustum = Frustum(geometry.intrinsics, shot.size, float(near) * _NEARER, float(far) * _FARTHER)
    scene = RadianceField(frustum, generator=generator)
    readings = _Readings(shot)
    first = torch.from_numpy(geometry.world_to_camera).float()
    first = first @ se3.inverse(first[geometry.reference])  # the field's world frame is the reference camera's
    twists = torch.zeros(shot.views, 6, requires_grad=True)
    moves = torch.ones(shot.views, 1)
    moves[geometry.reference] = 0.0
    optimiser = torch.optim.Adam(
        [{"params": scene.parameters(), "lr": settings.rate}, {"params": [twists], "lr": settings.pose_rate}],
        eps=1e-15,
        betas=(0.9, 0.99),
    )
    falling = torch.optim.lr_scheduler.ExponentialLR(optimiser, (1 / 20) ** (1 / settings.iterations))
    loss_of: list[float] = []
    for iteration in range(settings.iterations):
        chosen = readings.draw(settings.pixels, generator)
        at_rest = iteration < settings.poses_from * settings.iterations
        poses = se3.exp((twists.detach() if at_rest else twists) * moves) @ first
        count = len(chosen)
        rays = readings.places[chosen].repeat(shot.views, 1)
        seen, _ = cast(scene, poses.repeat_interleave(count, dim=0), rays, settings.samples, generator)
        loss = readings.loss(chosen, seen.reshape(shot.views, count, 3))
        if not torch.isfinite(loss):
            raise NumericsError("the loss of the radiance field is not finite", remedy="lower its rate")
        optimiser.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]
        optimiser.step()
        falling.step()
        loss_of.append(float(loss.detach()))
    with torch.no_grad():
        path = (se3.exp(twists * moves) @ first).double().numpy()
    return FittedField(scene, path, settings.samples, loss_of)


class _Readings:
    """The pixels that some mask opens: their positions, transmissions and readings."""

    def __init__(self, shot: Shot) -> None:
        lit = np.flatnonzero(shot.lit)
        height, width = shot.size
        self.places = torch.from_numpy(np.stack([lit % width + 0.5, lit // width + 0.5], axis=1)).float()
        masks = shot.masks * shot.weights[:, None, None]
        self._transmissions = torch.from_numpy(masks.reshape(shot.views, -1)[:, lit]).float()
        self._readings = torch.from_numpy(shot.measurement.reshape(height * width, -1)[lit]).float()
        clipped = np.zeros(shot.size, bool) if shot.saturated is None else shot.saturated
        self._clipped = torch.from_numpy(clipped.ravel()[lit])
        self._channels = (
            None if shot.cfa is None else cfa_channels(shot.cfa, shot.size).reshape(-1)[torch.as_tensor(lit)]
        )

    def draw(self, count: int, generator: torch.Generator) -> Tensor:
        return torch.randint(len(self.places), (count,), generator=generator)

    def loss(self, chosen: Tensor, seen: Tensor) -> Tensor:
        """Return the mean absolute error of the prediction by views, [N, P, 3]; clipped readings are lower bounds."""
        coded = (self._transmissions[:, chosen, None] * seen).sum(dim=0)
        if self._channels is not None:
            coded = coded.gather(1, self._channels[chosen, None])
        elif self._readings.shape[1] == 1:
            coded = coded.mean(dim=1, keepdim=True)
        error = coded - self._readings[chosen]
        return torch.where(self._clipped[chosen, None], error.clamp(max=0), error).abs().mean()
