"""Motion blur: the camera moves while a mask is on show, so what each mask passes is an integral over time."""

from dataclasses import dataclass
from functools import cache
from typing import ClassVar, Final

import numpy as np

from gs2ci.core.arrays import F64
from gs2ci.core.errors import InputError
from gs2ci_sims.effects.base import Bound, BoundStep, Previewed, Stage
from gs2ci_sims.moments import Moments, gauss_nodes, gauss_weights, lagrange
from gs2ci_sims.motion import sweep_errors
from gs2ci_sims.rig import Rig

# Phases over a panel, radians, for which the errors of interpolation and quadrature are tabulated; a frequency at
# the pixel's Nyquist limit turns by pi per pixel of motion.
PHASES: Final = np.concatenate([[0.0], np.geomspace(1e-3, 1e3, 400)])
# Frequencies of the image, cycles per pixel, up to twice the pixel's Nyquist limit along both axes.
FREQUENCIES: Final = np.concatenate([np.linspace(0, 0.1, 5)[:-1], np.linspace(0.1, 2**0.5, 12)])


@dataclass(frozen=True)
class MotionBlur:
    """Sample the moving image at as many moments as its motion calls for, and integrate over all of them.

    Off, each mask sees one moment: the middle of its interval.

    Args:
        nodes: Views per panel of time, at least 1; the planner chooses.
        edges_s: Ends of the panels, increasing; empty: one panel per mask interval.
    """

    name: ClassVar[str] = "motion_blur"
    stage: ClassVar[Stage] = Stage.MOMENTS
    cost_ns: ClassVar[float] = 0.0
    fixed_pattern: ClassVar[bool] = False

    nodes: int = 3
    edges_s: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        if self.nodes < 1 or len(self.edges_s) == 1:
            raise InputError(
                f"motion blur with {self.nodes} views in each panel between {self.edges_s}",
                allowed="1 or more; two or more ends of panels, or none",
            )

    def bound(self, scene: Previewed, rig: Rig) -> Bound:
        """Each view's spectrum, times what one view per mask misses of a sweep through the fastest interval.

        A cosine of frequency f swept over d pixels keeps sin(x)/x of its amplitude, x = pi f d: the transfer
        function of linear motion (Boreman, Modulation Transfer Function in Optical Systems, section 2.2). A camera
        that swings also has its mean place elsewhere than in the middle of the interval.
        """
        return panel_bound(scene, np.unique(scene.intervals_s), 1, 0.0).after(
            BoundStep(
                "d",
                float(scene.motion_px.max()),
                "px",
                "motion of the image under one mask, at most; a cosine of frequency k keeps sinc(k d)",
            ),
        )

    def apply(self, signal: Moments, rig: Rig, rng: np.random.Generator) -> Moments:
        """Replace the one moment per interval."""
        return Moments(np.array(self.edges_s) if self.edges_s else signal.edges_s, self.nodes)


@cache
def interpolation_error(nodes: int) -> F64:
    """Return the rms error over a panel of interpolating exp(i phase t), t in [-1/2, 1/2], at each of `PHASES`."""
    places = np.linspace(0, 1, 65)
    wave = np.exp(1j * PHASES[:, None] * places)
    at_nodes = np.exp(1j * PHASES[:, None] * gauss_nodes(nodes))
    error = np.abs(wave - at_nodes @ lagrange(gauss_nodes(nodes), places).T)
    return np.asarray(np.maximum.accumulate(np.sqrt(np.square(error).mean(axis=1))))


@cache
def quadrature_error(nodes: int) -> F64:
    """Return the error of integrating exp(i phase t) over a panel with Gauss-Legendre nodes, at each of `PHASES`."""
    centred = gauss_nodes(nodes) - 0.5
    exact = np.sinc(PHASES / (2 * np.pi))
    return np.asarray(np.maximum.accumulate(np.abs(exact - np.cos(PHASES[:, None] * centred) @ gauss_weights(nodes))))


def panel_bound(scene: Previewed, edges_s: F64, nodes: int, unevenness: float | None) -> Bound:
    """Bound the error of sampling the moving image with `nodes` views in each panel.

    Args:
        scene: A quick look.
        edges_s: Ends of the panels.
        nodes: Views per panel.
        unevenness: How unevenly light is collected within a panel, as a share (0: evenly, the integral of the
            image is all that counts and quadrature is far better than interpolation); None: masks switch within a
            panel, the image is needed at every moment.
    """
    quadrature, interpolation = sweep_errors(
        scene.scene, scene.path, edges_s, nodes, FREQUENCIES, scene.object_px_per_s
    )
    errors = interpolation
    if unevenness is not None:
        errors = np.minimum(errors, quadrature + unevenness * errors)
    return scene.of_views(*scene.filtered(lambda f: np.interp(f, FREQUENCIES, errors)))


def even_panel_rms_dn(scene: Previewed, panel_px: float, nodes: int, unevenness: float | None) -> float:
    """Return what `panel_bound` would be for an even motion of so many pixels per panel: a first guess, DN rms."""
    phases = 2 * np.pi * panel_px
    errors = interpolation_error(nodes)
    if unevenness is not None:
        errors = np.minimum(errors, quadrature_error(nodes) + unevenness * errors)
    return scene.of_views(*scene.filtered(lambda f: np.interp(phases * f, PHASES, errors))).rms_dn
