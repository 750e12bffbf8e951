"""A whole draft on a device, for which the CPU stands in by fibers: the same stages, and views as good as the CPU's."""

from dataclasses import replace

import numpy as np
import pytest
import torch

pytest.importorskip("warp", reason="Warp is not installed")

from gs2ci.core.findings import Code
from gs2ci.evaluate.metrics import psnr_per_view
from gs2ci.reconstruct import pipeline
from gs2ci.reconstruct.hypotheses import fitting
from gs2ci.reconstruct.presets.named import preset
from gs2ci.render import devices, places
from gs2ci.render.cards import Card, Cuda
from gs2ci.render.devices import CudaProbe
from tests.nightly import NIGHTLY, but
from tests.render.pretended_card import lies_there, pretended_card
from tests.stability.benches import Bench

# Warp's name of the CPU, as if it were a card.
FIBERS = Card("cpu", "fibers", (7, 5), 100_000, 100_000)


# What torch adds up on CUDA in an order that differs from run to run (`torch.use_deterministic_algorithms`).
IN_ANY_ORDER = ("scatter_add", "index_add", "scatter_reduce", "put", "cumsum", "bincount", "histc", "kthvalue")
IN_ANY_ORDER += tuple(f"{name}_" for name in IN_ANY_ORDER)


class Told:
    """Keeps the stages that a reconstruction begins."""

    def __init__(self):
        self.stages = []

    def stage(self, name, steps=None):
        self.stages.append(name)

    def step(self, *_, **__):
        """Nothing is kept of a step."""

    def expect(self, steps):
        """Nothing is kept of a schedule."""

    def say(self, sentence):
        """Nothing is kept of sentences."""


@pytest.fixture
def draft(monkeypatch):
    """Reconstruct an exposure by a draft on a device, and return what was found with the stages."""
    monkeypatch.setattr(
        devices, "CudaProbe", lambda: CudaProbe(lambda: True, lambda: Cuda((13, 0), (13, 0), (7, 5), (FIBERS,)))
    )

    def reconstruct(shot, device, iterations=None, *, apart=True):
        # Whether a path is sought again, or motion is tried, depends on a fit's residual, which rounding moves.
        settings = replace(preset("draft"), device=device, look_again=False, motion="off")
        told = Told()
        if iterations is not None:
            settings = replace(settings, fit=replace(settings.fit, iterations=iterations))
        places.count_host_as_device(yes=apart and device == "auto")
        try:
            return pipeline.reconstruct(shot, settings, told).result, told.stages
        finally:
            places.count_host_as_device(yes=False)

    return reconstruct


def psnr_db(shot, result):
    return float(np.mean(psnr_per_view(result.views, shot.truth.views)))


@pytest.mark.parametrize("apart", [False, True], ids=["rendering alone", "all that can be"])
def test_a_few_iterations_on_a_card_are_those_of_the_cpu(draft, apart):
    shot = Bench("planes", views=4).expose((24, 32))
    (there, stages), (here, same) = draft(shot, "auto", 4, apart=apart), draft(shot, "cpu", 4)
    assert (there.device, here.device) == ("cpu (fibers)", "cpu")
    assert there.notes[0].code is Code.GPU_USED
    assert stages == same
    np.testing.assert_allclose(there.views, here.views, atol=0.01)
    assert psnr_db(shot, there) == pytest.approx(psnr_db(shot, here), abs=0.1)


@pytest.mark.parametrize("case", but(1, [("draft", "planes", 6), ("standard", "boxes", 20)]))
def test_tensors_of_a_card_and_of_the_host_are_kept_apart(case):
    name, scene, iterations = case
    shot, settings = Bench(scene, views=4).expose((24, 32)), replace(preset(name), backend="warp")
    settings = replace(settings, fit=replace(settings.fit, iterations=iterations))
    with pretended_card() as card:
        found = pipeline.reconstruct(shot, settings)
    there = found.result
    assert not any(map(lies_there, found.scene.parameters().values()))
    here = pipeline.reconstruct(shot, replace(settings, backend="cpu")).result
    assert card.names.total() > 10_000
    assert not [name for name in IN_ANY_ORDER if card.of_floats[name]]
    assert psnr_db(shot, there) == pytest.approx(psnr_db(shot, here), abs=0.2)


MOVED = (0.0, 1e-7, 2e-7, 3e-7)


@NIGHTLY
def test_drafts_on_a_card_are_in_the_mean_as_good_as_the_cpus(draft, monkeypatch):
    """First positions are moved by up to 3e-7 of theirs: a fit that adds Gaussians makes tenths of a dB of it.

    So the means of several drafts are compared: to 0.1 dB, and three times the standard error of their difference.
    """
    shot, plain = Bench("planes").expose((48, 64)), fitting.first_gaussians

    def shaken(moved):
        def start(*given):
            first = plain(*given)
            draws = torch.Generator().manual_seed(int(moved * 1e9))
            first.means = first.means * (1 + moved * torch.randn(first.means.shape, generator=draws))
            return first

        return start

    found = {"auto": [], "cpu": []}
    for moved in MOVED:
        monkeypatch.setattr(fitting, "first_gaussians", shaken(moved))
        (there, stages), (here, same) = draft(shot, "auto"), draft(shot, "cpu")
        assert stages == same
        assert there.verdict == here.verdict
        assert there.gaussians == pytest.approx(here.gaussians, rel=0.1)
        found["auto"].append(psnr_db(shot, there))
        found["cpu"].append(psnr_db(shot, here))
    print(found)  # docs/gpu.md has these figures
    error_db = np.sqrt(sum(np.var(one, ddof=1) / len(one) for one in found.values()))
    assert np.mean(found["auto"]) == pytest.approx(np.mean(found["cpu"]), abs=0.1 + 3 * error_db)
