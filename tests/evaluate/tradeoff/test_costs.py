import math
from dataclasses import replace

import numpy as np
import pytest

from gs2ci.core.errors import InputError
from gs2ci.core.records import Shot
from gs2ci.evaluate.tradeoff import costs
from gs2ci.evaluate.tradeoff.costs import CostModel, probe
from gs2ci.reconstruct.presets.named import PRESETS, rescheduled

MODEL = CostModel(
    pixels=90_000, views=8, decode_step=0.01, geometry=1.0, plane=0.01, iteration=0.05, gaussian=1e-6, look=0.2
)


def shot(views=4, size=(60, 90), cfa=None):
    rng = np.random.default_rng(2)
    masks = (rng.random((views, *size)) < 0.3).astype(np.float32)
    channels = 1 if cfa else 3
    measurement = rng.random((*size, channels)).astype(np.float32)
    return Shot(measurement, masks, np.ones(views, np.float32), cfa=cfa).check()


@pytest.mark.parametrize(
    "given", [shot(), shot(cfa="RGGB"), shot(views=1, size=(16, 16)), shot(views=3, size=(8, 200))]
)
def test_the_probe_finds_a_price_above_zero_for_every_part(given):
    model = probe(given)
    assert model.pixels == given.size[0] * given.size[1]
    assert model.views == given.views
    for name in ("decode_step", "plane", "iteration", "look"):
        assert 0 < getattr(model, name) < 60, name
    assert model.geometry >= 0
    assert model.gaussian >= 0
    assert math.isfinite(model.predict(PRESETS["fine"]).total)


def test_the_probe_looks_at_a_piece_of_a_large_shot_and_scales(monkeypatch):
    seen = []

    def priced(crop, backend):
        seen.append(crop.size)
        return replace(MODEL, pixels=crop.size[0] * crop.size[1])

    monkeypatch.setattr(costs, "_probe_crop", priced)
    monkeypatch.setattr(costs, "_CROP_VIEW_PIXELS", 40_000)
    given = shot(size=(400, 500))
    model = probe(given)
    assert seen[-1][0] * seen[-1][1] * given.views == pytest.approx(40_000, rel=0.05)
    larger = 400 * 500 / (seen[-1][0] * seen[-1][1])
    assert model.decode_step == pytest.approx(larger * MODEL.decode_step)
    assert model.gaussian / MODEL.gaussian == pytest.approx(model.look / (larger * MODEL.look))


def test_the_probe_counts_the_stage_among_the_sources(monkeypatch):
    monkeypatch.setattr(costs, "_probe_crop", lambda crop, backend: MODEL)
    given = shot()
    assert probe(given).sources == 1
    assert probe(replace(given, telemetry_world_to_camera=np.tile(np.eye(4), (given.views, 1, 1)))).sources == 2


def test_a_crop_without_an_open_mask_is_priced_all_the_same():
    dark = shot(size=(300, 300))
    masks = np.zeros_like(dark.masks)
    masks[:, 0, 0] = 1
    assert probe(replace(dark, masks=masks)).iteration > 0


def test_a_shot_whose_parts_do_not_fit_is_refused():
    with pytest.raises(InputError):
        probe(replace(shot(), weights=np.ones(3, np.float32)))
    with pytest.raises(InputError, match="backend"):
        probe(shot(), "abacus")


def test_the_price_grows_with_every_setting_that_costs():
    base = PRESETS["standard"]
    dearer = [
        replace(base, decode=replace(base.decode, iterations=80)),
        replace(base, geometry=replace(base.geometry, sweep=replace(base.geometry.sweep, planes=192))),
        replace(base, fit=rescheduled(base.fit, 2000)),
        replace(base, fit=replace(base.fit, gaussians_per_pixel=1.0)),
        replace(base, stride_px=1),
    ]
    for one in dearer:
        assert MODEL.predict(one).total > MODEL.predict(base).total


def test_a_stage_that_is_asked_beside_the_tracks_costs_as_much_again():
    both = replace(MODEL, sources=2)
    settings = PRESETS["standard"]
    assert both.predict(settings).geometry == pytest.approx(2 * MODEL.predict(settings).geometry)
    assert both.predict(replace(settings, poses="tracks")) == MODEL.predict(settings)


def test_the_population_grows_from_the_first_points_to_the_cap():
    base = PRESETS["standard"]
    counts = [MODEL.population(base, share) for share in (0, 0.2, 0.4, 0.8, 1)]
    assert counts == sorted(counts)
    assert counts[0] == pytest.approx(1.1 * 90_000 / 9)
    assert counts[-1] == 0.25 * 90_000


def test_fits_side_by_side_share_the_threads():
    def fit_s(fits, threads):
        model, settings = replace(MODEL, threads=threads), replace(PRESETS["standard"], fits=fits)
        looks = settings.fit.iterations // settings.fit.hold_out.look_every
        return model.predict(settings).fit - looks * MODEL.look

    alone = fit_s(1, 1)
    assert fit_s(1, 4) == pytest.approx(alone)  # an iteration was measured with all of them
    assert fit_s(3, 1) == pytest.approx(3 * alone)
    assert fit_s(2, 2) == pytest.approx(alone / 0.65)
    assert alone < fit_s(2, 4) < fit_s(2, 2) < fit_s(4, 2) == pytest.approx(2 * fit_s(2, 2))
