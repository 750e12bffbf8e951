"""A scene of 3D Gaussians as optimisable parameters, with numerically stable opacities and rotations.

Here: the parameters, their positions at a moment, their checks and conversions. Not here: files (`ply.py`), rendering,
densification rules (`gs2ci.reconstruct.fit.density`).
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import torch
from torch import Tensor

from gs2ci.core.errors import InputError
from gs2ci.render.conventions import QUATERNION_NORM_MIN
from gs2ci.render.places import on_device

HARMONICS: Final = (0, 3, 8, 15)
"""Number of spherical harmonics above the constant one up to degree 0, 1, 2 and 3."""

_FIELD_COLUMNS = {"means": 3, "log_scales": 3, "quaternions": 4, "opacity_logits": None, "colours": 3}


@dataclass
class Gaussians:
    """G Gaussians, unconstrained so that any step of an optimiser stays valid.

    Args:
        means: Centres in scene units, [G, 3].
        log_scales: Natural logs of the standard deviations along the own axes, [G, 3].
        quaternions: Rotations own axes -> world, (w, x, y, z), of any norm, [G, 4]; zero means no rotation.
        opacity_logits: Opacity = sigmoid, [G].
        colours: Linear, in the unit of a view's full scale, not clamped, [G, 3].
        motion: Motion of the centres, [G, K, 3]: at time t they are at means + sum_k motion_k t^k, k = 1 ... K. The
            caller chooses the unit of time; a reconstruction counts from −1 to 1 over the exposure, so that the first
            row is the distance covered in half the exposure. None: nothing moves.
        harmonics: The direction-dependent part of the colours: coefficients of the spherical harmonics of degree 1 up
            to 1, 2 or 3, [G, 3, 8 or 15, 3], the last axis RGB (`gs2ci.render.harmonics`). None: colours do not depend
            on direction.

    Example:
        >>> scene = gs2ci.open_run("run").scene
        >>> len(scene), tuple(scene.means.shape), scene.motion
        (50, (50, 3), None)
    """

    means: Tensor
    log_scales: Tensor
    quaternions: Tensor
    opacity_logits: Tensor
    colours: Tensor
    motion: Tensor | None = None
    harmonics: Tensor | None = None

    def __len__(self) -> int:
        return int(self.means.shape[0])

    def _repr_png_(self) -> bytes | None:
        """Show the centres in their colours, from in front and slightly above, like most of our cameras.

        Centres alone need no rasteriser; None if nothing is visible.
        """
        from gs2ci.core.notebook import png_of  # noqa: PLC0415  imported only if a picture is drawn
        from gs2ci.render.sketch import sketch  # noqa: PLC0415  as above

        own = self.detach().map(lambda tensor: tensor.double())
        # The geometric mean of the two wider axes: what a surface's disc covers.
        sizes = own.log_scales.sort(dim=1).values[:, 1:].mean(dim=1).exp()
        drawn = sketch(*(t.numpy() for t in (own.means, own.colours, torch.sigmoid(own.opacity_logits), sizes)))
        return None if drawn is None else png_of(drawn)

    def _repr_html_(self) -> str:
        from gs2ci.core.notebook import card  # noqa: PLC0415  as above

        facts = [("Gaussians", f"{len(self)}")]
        if len(self):
            means, opacity = self.means.detach(), torch.sigmoid(self.opacity_logits.detach())
            low, high = means.amin(dim=0), means.amax(dim=0)
            facts += [
                ("from", ", ".join(f"{value:.4g}" for value in low.tolist())),
                ("to", ", ".join(f"{value:.4g}" for value in high.tolist())),
                ("median opacity", f"{float(opacity.median()):.3g}"),
                ("median size", f"{float(self.log_scales.detach().exp().median()):.3g}"),
            ]
        return card("scene", facts, self._repr_png_(), caption="centres of the Gaussians")

    def parameters(self) -> dict[str, Tensor]:
        """Return the tensors by field name; `motion` and `harmonics` only if there are any."""
        # A dataclass keeps its fields there in their order, and asking for them by `fields` takes ten times as long.
        return {name: tensor for name, tensor in vars(self).items() if tensor is not None}

    def means_at(self, times: Tensor) -> Tensor:
        """Return the centres at moments [V]: [V, G, 3], or [G, 3] for all of them if nothing moves."""
        if self.motion is None:
            return self.means
        powers = torch.stack([times**k for k in range(1, self.motion.shape[1] + 1)], dim=1).to(self.motion.dtype)
        return self.means + torch.einsum("vk,gkc->vgc", powers, self.motion)

    def at(self, moment: float) -> "Gaussians":
        """Return the scene at one moment, as a still scene."""
        still = {name: tensor for name, tensor in self.parameters().items() if name != "motion"}
        means = self.means_at(torch.tensor([moment], dtype=self.means.dtype))
        return Gaussians(**(still | {"means": means.reshape(-1, 3)}))

    def map(self, function: Callable[[Tensor], Tensor]) -> "Gaussians":
        """Return Gaussians with `function` applied to every field, for selecting, copying and casting."""
        return Gaussians(**{name: function(tensor) for name, tensor in self.parameters().items()})

    def detach(self) -> "Gaussians":
        """Return the same numbers detached from any graph."""
        return self.map(torch.Tensor.detach)

    def check(self) -> "Gaussians":
        """Return self if the fields fit together and hold finite numbers.

        Raises:
            InputError: A shape, dtype or device does not fit, or a value is NaN or infinite.
        """
        count = self.means.shape[0] if self.means.ndim else 0
        for name, tensor in self.parameters().items():
            wanted: tuple[int, ...]
            if name == "motion":
                wanted = (count, max(1, tensor.shape[1] if tensor.ndim == 3 else 1), 3)
            elif name == "harmonics":
                wanted = (count, _harmonics_of(tensor), 3)
            else:
                columns = _FIELD_COLUMNS[name]
                wanted = (count,) if columns is None else (count, columns)
            check_tensor(f"{name} of the Gaussians", tensor, wanted)
        return self


def joined(parts: Sequence[Gaussians]) -> Gaussians:
    """Return the Gaussians of several scenes with the same fields as one scene, in their order."""
    fields = [part.parameters() for part in parts]
    return Gaussians(**{name: torch.cat([one[name] for one in fields]) for name in fields[0]})


def _harmonics_of(tensor: Tensor) -> int:
    """Return how many harmonics a tensor [G, K, 3] has.

    Raises:
        InputError: K is not one of the possible numbers.
    """
    found = int(tensor.shape[1]) if tensor.ndim == 3 else 0
    if found not in HARMONICS[1:]:
        raise InputError(
            f"harmonics of the Gaussians of shape {list(tensor.shape)}",
            allowed=f"[G, K, 3] with K one of {', '.join(map(str, HARMONICS[1:]))}: degree 1, 2 or 3",
        )
    return found


def check_tensor(what: str, tensor: Tensor, wanted: tuple[int, ...]) -> None:
    """Accept a tensor of finite floating-point numbers and a given shape.

    On a device only kind and shape are looked at: its numbers would have to be waited for, and fits test their own.

    Raises:
        InputError: It is not one.
    """
    if tuple(tensor.shape) != wanted or not tensor.is_floating_point() or tensor.device.type not in {"cpu", "cuda"}:
        raise InputError(
            f"{what}: {str(tensor.dtype).removeprefix('torch.')} {list(tensor.shape)} on {tensor.device}",
            allowed=f"float32 or float64 {list(wanted)} on cpu",
        )
    if not on_device(tensor) and not all_finite(tensor.detach()):
        bad = int((~torch.isfinite(tensor.detach())).sum())
        raise InputError(
            f"{what}: {bad} of {tensor.numel()} values are NaN or infinite",
            allowed="finite numbers",
            remedy="go back to the last finite parameters and lower the learning rate",
        )


def all_finite(*tensors: Tensor) -> bool:
    """Tell whether all numbers of tensors are finite; fast, since a fit calls it several times in each iteration."""
    if not tensors:
        return True
    if on_device(tensors[0]):  # one answer for all, since each is waited for
        return math.isfinite(float(torch.nn.utils.get_total_norm(tensors, math.inf)))
    # A finite sum proves it; only if the sum is not finite, which may be an overflow, are the numbers tested one by
    # one.
    return all(math.isfinite(float(one.sum())) or bool(torch.isfinite(one).all()) for one in tensors)


def logit(probability: Tensor) -> Tensor:
    """Return ln(p / (1 - p)) without losing p near 0 or 1 - p near 1, for p in [0, 1]; infinite at the ends."""
    return torch.log(probability) - torch.log1p(-probability)


def transmittance_preserving_opacity(opacity_logits: Tensor) -> Tensor:
    """Return the logits of alpha' = 1 - sqrt(1 - alpha): two such layers transmit as much as the one.

    This is the opacity for both halves of a split or duplicated Gaussian (revised densification; paper, section III-E).
    In logit space: with r = sqrt(1 - alpha), alpha' / (1 - alpha') = (1 - r) / r, where
    ln r = ln(sigmoid(-x)) / 2. Then logit' = ln(1 - r) - ln r with 1 - r = -expm1(ln r): nothing cancels, and
    logits of +-20, where 1 - alpha or alpha is below float32's resolution of 1, keep all their digits.

    Args:
        opacity_logits: x with alpha = sigmoid(x), any shape.
    """
    log_root = 0.5 * torch.nn.functional.logsigmoid(-opacity_logits)
    # If alpha underflows (x < -87 in float32), 1 - r is 0 and its log infinite: it is bounded here.
    smallest = torch.finfo(log_root.dtype).tiny
    return torch.log((-torch.expm1(log_root)).clamp(min=smallest)) - log_root


def rotation_matrices(quaternions: Tensor) -> Tensor:
    """Turn quaternions (w, x, y, z) of any norm into rotation matrices, [..., 4] -> [..., 3, 3].

    A quaternion shorter than `QUATERNION_NORM_MIN` gives the identity, with zero gradient.
    """
    norm2 = (quaternions * quaternions).sum(dim=-1, keepdim=True)
    present = norm2 >= QUATERNION_NORM_MIN**2
    safe_norm = torch.where(present, norm2, torch.ones_like(norm2)).sqrt()
    # With w = x = y = z = 0 the formula below gives the identity.
    w, x, y, z = torch.where(present, quaternions / safe_norm, torch.zeros_like(quaternions)).unbind(-1)
    rows = (
        *(1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        *(2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        *(2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )
    return torch.stack(rows, dim=-1).reshape(*quaternions.shape[:-1], 3, 3)
