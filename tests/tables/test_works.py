"""What cells measure, on a scene of the library."""

from dataclasses import asdict, replace

import numpy as np
import pytest

from gs2ci.evaluate.metrics import psnr_per_view
from gs2ci.reconstruct.settings import Settings
from tests.tables import works
from tests.tables.cases import Case
from tests.tables.columns import INITIALISATION, PATH, POPULATION
from tests.tables.works import initialise_case, reconstruct_case


@pytest.mark.parametrize("variant", ["default", "eni"])
def test_a_first_geometry_is_measured_against_the_truth(variant):
    row = initialise_case(asdict(Case("boxes", scene="boxes", size=(48, 64), views=4)), variant, 0)
    assert {measure.key for measure in INITIALISATION} <= row.keys()
    assert row["unexplained"] > 0
    assert row["full"] in (0.0, 1.0)
    assert row["rpe_r_deg"] >= 0
    assert (row["depth_rank"] is None) == (row["verdict"] != "full")
    assert row["failure"] == "" or row["depth_rank"] is None or "exchanged" in row["failure"]
    assert row["source"] == "tracks"
    assert (row["path_error_expected"] is None) == (row["verdict"] != "full")


def brief(_variant, seed):
    """Settings that fit next to nothing."""
    settings = Settings(seed=seed, fits=1, poses="tracks", look_again=False, motion="off")
    return replace(settings, fit=replace(settings.fit, iterations=8))


def test_a_scene_is_scored_at_its_views_and_beside_its_path(monkeypatch):
    monkeypatch.setattr(works, "settings_of", brief)
    case = Case("boxes", scene="boxes", size=(32, 48), views=4)
    row = reconstruct_case(asdict(case), "default", 0)
    assert {measure.key for measure in (*POPULATION, *PATH)} <= row.keys()
    for key in ("psnr_db", "scene_psnr_db", "between_psnr_db", "beyond_psnr_db"):
        assert 5 < row[key] < 60
    assert row["frames_per_second"] > 0
    extent = row["ate"] / row["nate"]
    assert row["nrpe_t"] == pytest.approx(row["rpe_t"] / extent)
    path = case.shot(0).truth.world_to_camera
    centres = -np.einsum("nji,nj->ni", path[:, :3, :3], path[:, :3, 3])
    assert extent == pytest.approx(np.linalg.norm(np.ptp(centres, axis=0)))


def test_the_least_of_several_times_is_told(monkeypatch):
    done = []
    clock = iter([0.0, 5.0, 6.0, 6.5, 7.0, 9.0])
    monkeypatch.setattr(works.time, "perf_counter", lambda: next(clock))
    assert works.least_seconds(lambda: done.append(1), 3) == 0.5
    assert len(done) == 3


def test_a_scene_is_seen_from_beside_its_path_as_the_simulator_shows_it():
    case = Case("planes", scene="planes", size=(32, 48), views=5)
    shot = case.shot(0)
    novel = case.novel_views(shot)
    assert novel.views.shape == (2, 32, 48, 3)
    # Half way between the two middle views is closer to each than they are to one another.
    before, after = shot.truth.views[1], shot.truth.views[2]
    apart = psnr_per_view(before[None], after[None])[0]
    assert min(psnr_per_view(novel.views[[0, 0]], np.stack([before, after]))) > apart
    # One step on from the last view lies that much further from the first.
    towards = psnr_per_view(np.stack([shot.truth.views[-1], novel.views[1]]), shot.truth.views[[0, 0]])
    assert towards[1] < towards[0]


@pytest.mark.parametrize("scene", ["moving"])
def test_nobody_knows_what_else_a_moving_scene_shows(scene):
    case = Case(scene, scene=scene, size=(24, 32), views=3)
    assert case.novel_views(case.shot(0)) is None
