"""A photograph on a plane that moves a little from view to view, coded by random masks."""

from dataclasses import dataclass

import numpy as np
import pytest
from scipy.ndimage import shift as moved
from skimage.data import astronaut

from gs2ci.core.records import Shot, Truth


@dataclass(frozen=True)
class Bench:
    """True views and drawn masks; `shoot` exposes through masks as they were, and states others."""

    views: np.ndarray
    masks: np.ndarray

    def shoot(self, *, were=None, stated=None, noise=0.01, seed=0, black=0.0, unit=1.0):
        were = self.masks if were is None else were
        light = (were[..., None] * self.views).sum(axis=0) + black
        light += np.random.default_rng(seed).normal(0, noise, light.shape)
        masks = self.masks if stated is None else stated
        measurement = (unit * light).astype(np.float32)
        weights = np.ones(len(masks), np.float32)
        return Shot(measurement, masks.astype(np.float32), weights, truth=Truth(self.views.astype(np.float32))).check()


@pytest.fixture(scope="session")
def bench():
    """Six views of 96 × 112 px, a third of each mask open."""
    picture = astronaut()[60:300:2, 140:400:2].astype(float) / 255
    views = np.stack([moved(picture, (0.3 * k, -0.7 * k, 0), order=1, mode="nearest")[:96, :112] for k in range(6)])
    masks = (np.random.default_rng(5).random((6, 96, 112)) < 0.33).astype(np.float32)
    return Bench(views, masks)
