"""The preset `paper` against the constants that the paper prints, each with its section (docs/paper-preset.md).

The table is copied from the paper's text, not from the code. What cannot be read off a setting is measured: turns of
the density rule, resets, rates along the schedule.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from gs2ci.core.errors import InputError
from gs2ci.core.findings import Code
from gs2ci.reconstruct.fit.coarse.settings import CoarseSettings
from gs2ci.reconstruct.fit.density.base import GaussianStatistics
from gs2ci.reconstruct.fit.losses.objective import LossWeights
from gs2ci.reconstruct.fit.optimiser.gaussians import GaussianOptimiser
from gs2ci.reconstruct.fit.optimiser.poses import length_of
from gs2ci.reconstruct.paper.preset import MOST_GAUSSIANS, paper_settings
from gs2ci.reconstruct.paper.proxies import amdi
from gs2ci.reconstruct.paper.proxies.routing import MULTIPLICITY_THRESHOLD
from gs2ci.reconstruct.pipeline import reconstruct
from tests.tables.cases import Case

PAGE = (Path(__file__).parents[3] / "docs" / "paper-preset.md").read_text(encoding="utf-8")
SETTINGS = paper_settings().check()
FIT, FINE = SETTINGS.fit, SETTINGS.fine_if_asked


def turns():
    shares = ((i, i / FIT.iterations) for i in range(FIT.iterations))
    return [i for i, s in shares if FIT.densify_from <= s < FIT.densify_until and i % FIT.densify_every == 0]


CONSTANTS = [
    # what, section, as the paper prints it, as the preset has it
    ("seed", "IV-A", 42, SETTINGS.seed),
    ("threshold of the multiplicity", "III-B, S-I", 4, MULTIPLICITY_THRESHOLD),
    ("least eigenvalue of AMDI", "S-I", 1, amdi.LAMBDA_MIN),
    ("factor on the condition number of AMDI", "S-I", 2, amdi.KAPPA_FACTOR),
    ("ridge of AMDI", "S-I", 1e-3, amdi.RIDGE),
    ("windows of AMDI", "S-I", (3, 5, 7, 9, 11, 13, 15, 17, 21, 25, 31, 41, 57, 81), amdi.WINDOW_SIZES),
    ("iterations of the coarse stage", "IV-A", 20_000, FIT.iterations),
    ("weight of 1 − SSIM", "IV-A", 0.1, FIT.loss.similarity),
    ("weight of the mean opacity", "IV-A", 0.01, FIT.loss.opacity),
    ("iterations over which pose gradients are accumulated", "IV-A", 25, FIT.poses.every),
    ("rate of pose corrections at the start", "IV-A", 1e-2, FIT.poses.rate),
    ("rate of pose corrections at the end", "IV-A", 2e-5, FIT.poses.final_rate),
    ("rate of the means at the start", "IV-A", 1.6e-4, FIT.steps.means),
    ("rate of the means at the end", "IV-A", 1.6e-6, FIT.steps.means * FIT.steps.means_final_share),
    ("iterations between turns of densification", "IV-A", 100, FIT.densify_every),
    ("first turn of densification", "IV-A", 500, turns()[0]),
    ("end of densification", "IV-A", 15_000, turns()[-1] + FIT.densify_every),
    ("iteration whose population bounds all later ones", "IV-A, S-II", 7_000, round(FIT.cap_from * FIT.iterations)),
    ("iterations between resets of opacity", "IV-A", 3_000, FIT.density.criteria.reset_every),
    ("neighbours of the local opacity", "S-II", 3, FIT.density.neighbours),
    ("budget of splits by opacity", "S-II", 0.05, FIT.density.extra_splits),
    ("iterations of the fine stage", "IV-A", 3_000, FINE.iterations),
    ("weight of the pseudo-views", "IV-A", 0.006, FINE.pseudo_weight),
    ("weight of their ℓ1 term", "IV-A", 0.8, FINE.l1),
    ("weight of their perceptual term", "IV-A", 0.01, FINE.perceptual),
    ("support threshold", "IV-A", 0.25, FINE.support.threshold),
    ("softness of the support", "IV-A", 0.08, FINE.support.softness),
    ("least support weight", "IV-A", 0.10, FINE.support.least),
]


@pytest.mark.parametrize(("what", "section", "printed", "ours"), CONSTANTS, ids=[row[0] for row in CONSTANTS])
def test_a_constant_of_the_paper_is_the_presets_and_on_the_page_with_its_section(what, section, printed, ours):
    assert ours == (printed if isinstance(printed, tuple) else pytest.approx(printed))
    shown = ", ".join(map(str, printed)) if isinstance(printed, tuple) else f"{printed:,}"
    assert f"| {what} | {section} | {shown} |" in PAGE


def test_the_page_lists_no_constant_that_is_not_held_here():
    table = PAGE.split("## Constants")[1].split("##")[0]
    rows = [line.split("|")[1].strip() for line in table.splitlines() if line.startswith("| ")]
    assert rows[1:] == [row[0] for row in CONSTANTS]


def test_densification_runs_at_every_turn_between_its_ends():
    assert turns() == list(range(500, 15_000, 100))


def test_opacities_are_reset_every_3000_iterations(scattered):
    rule, reset, still = FIT.density, [], torch.zeros(4)
    for i in turns():
        seen = GaussianStatistics(still, still, lambda: still, extent=1.0, cap=9, iteration=i)
        result = rule.change(scattered(4), seen, torch.Generator())
        if "opacity_logits" in result.forget:
            reset.append(i)
    assert reset == [3000, 6000, 9000, 12_000]


def test_rates_decay_exponentially_in_the_unit_of_the_papers_trainer(scattered):
    optimiser = GaussianOptimiser(scattered(3), FIT.steps, extent=1.0)
    assert [optimiser.means_rate(share) for share in (0.0, 0.5, 1.0)] == pytest.approx([1.6e-4, 1.6e-5, 1.6e-6])
    assert FIT.steps.unit == FIT.poses.unit == "path cube"
    path = np.tile(np.eye(4), (3, 1, 1))
    path[:, 0, 3] = [-1.0, 1.0, 3.0]
    assert length_of("path cube", path) == pytest.approx(2.0)


def test_the_rule_ranks_by_opacity_first_and_lets_no_kind_of_candidate_starve():
    assert (FIT.density.opacity_splits, FIT.density.ranked_first, FIT.density.shared_room) == (True, True, True)
    assert not FIT.comparable_gradients


def test_no_pixel_is_held_out_nothing_ends_it_early_and_nothing_of_ours_comes_in_between():
    assert FIT.hold_out.share == 0
    assert min(FIT.hold_out.patience, FIT.hold_out.growth_patience) >= FIT.iterations
    assert (FIT.surfaces, FIT.loss.size) == (None, 0.0)
    assert (SETTINGS.fits, SETTINGS.second_density, SETTINGS.residual) == (1, None, None)
    assert not SETTINGS.may_look_again
    assert SETTINGS.brightness.rounds == 0
    assert SETTINGS.registration.mode == "off"
    assert SETTINGS.mask_moments.within_mask == "still"


def test_only_the_paper_bounds_the_population_and_the_guard_ends_the_fit():
    assert (FIT.gaussians_per_pixel, FIT.most_gaussians) == (None, MOST_GAUSSIANS)
    with pytest.raises(InputError, match="without any bound on its population"):
        replace(CoarseSettings(), gaussians_per_pixel=None).check()


def test_the_fine_stage_is_ungated_and_names_what_stands_in(monkeypatch, tmp_path):
    monkeypatch.setenv("GS2CI_HOME", str(tmp_path))
    assert not FINE.gated
    fine = FINE.load(LossWeights(), 0)
    assert [note.code for note in fine.notes] == [Code.STAND_IN, Code.STAND_IN]
    assert ["DiFix3D+" in fine.notes[0].sentence, "LPIPS" in fine.notes[1].sentence] == [True, True]


@pytest.fixture(scope="module")
def shortened():
    """A run of the preset with its fine stage, a hundred times faster and without what is shared by all presets."""
    settings = paper_settings()
    fit = replace(settings.fit, iterations=60, densify_every=2, hold_out=replace(settings.fit.hold_out, look_every=20))
    stage = replace(FINE, iterations=12, hold_out=replace(FINE.hold_out, look_every=4))
    return reconstruct(Case("boxes", scene="boxes", size=(48, 64)).shot(0), replace(settings, fit=fit, fine=stage))


def test_a_run_hands_over_its_scenes_views_and_says_what_stood_in(shortened):
    result = shortened.result
    assert result.verdict == "scene"
    np.testing.assert_array_equal(result.views, result.scene_views)
    assert result.heldout_rms == {"refined": None, "scene": None, "decode": None}
    codes = [note.code for note in result.notes]
    for expected in (Code.TRACKS_FOR_VGGT, Code.PROXIES_CHOSEN, Code.STAND_IN, Code.FINE_UNJUDGED):
        assert expected in codes


def test_the_fine_stage_of_a_run_refines(shortened):
    curve = [(point.iteration, point.loss) for point in shortened.result.curve]
    assert [at for at, _ in curve] == [20, 40, 60, 64, 68, 72]
    assert curve[-1][1] < curve[3][1]
