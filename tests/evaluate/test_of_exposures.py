"""Which shots belong to the views of a joint run, and the figures of each."""

import shutil
from dataclasses import replace

import numpy as np
import pytest

from gs2ci.core.errors import InputError
from gs2ci.core.records import Shot, Truth
from gs2ci.core.run_records import VERDICTS
from gs2ci.core.storage import write_shots
from gs2ci.core.summed import summed
from gs2ci.core.uncertainty import Uncertainty
from gs2ci.evaluate.evaluation import ReferenceData, evaluate, exposures_of
from gs2ci.evaluate.metrics import SensorNoise, image_scores
from gs2ci.evaluate.pages.run_evidence import read_run
from gs2ci.evaluate.report import ExposureSection, read_report
from gs2ci.evaluate.run_folder import write_run
from gs2ci.reconstruct.exposures.merging import merged, side_by_side
from tests.evaluate.reports import a_report

pytestmark = pytest.mark.usefixtures("undrawn")

NAMES = ("left", "middle", "right")


def section(name, first):
    return ExposureSection(
        name=name, first_view=first, views=2, verdict="refined", heldout_rms=dict.fromkeys(VERDICTS), path="stage",
        moved=None,
    )  # fmt: skip


def a_shot(name):
    masks = np.ones((2, 4, 5), np.float32)
    return Shot(np.ones((4, 5, 1), np.float32), masks, name=name)


def report_of(names):
    sections = [section(name, 2 * number) for number, name in enumerate(names)]
    return a_report().model_copy(update={"exposures": sections, "name": names[0]})


def test_shots_are_found_by_name_in_any_order_and_those_left_out_are_passed_over():
    shots = [a_shot(name) for name in ("right", "stray", "middle", "left")]
    found = exposures_of(report_of(NAMES), shots)
    assert [one.name for one in found] == list(NAMES)


def test_of_one_name_or_other_names_as_many_as_the_run_has_are_taken_in_their_order():
    shots = [replace(a_shot("shot"), measurement=np.full((4, 5, 1), float(k), np.float32)) for k in range(3)]
    assert exposures_of(report_of(["shot"] * 3), shots) == shots
    assert exposures_of(report_of(NAMES), shots) == shots
    single = a_report().model_copy(update={"exposures": [], "name": "measured"})
    assert exposures_of(single, shots[:1]) == shots[:1]


@pytest.mark.parametrize(
    ("names", "said"),
    [(["left", "right"], "middle is missing"), ([*NAMES, "left"], "left is there more than once")],
)
def test_too_few_and_too_many_of_one_name_are_refused(names, said):
    with pytest.raises(InputError, match=said):
        exposures_of(report_of(NAMES), [a_shot(name) for name in names])


@pytest.fixture(scope="module")
def joint(make_run, scene, tmp_path_factory):
    """A run of two exposures, each with the truth, the second noisier; and the exposures."""
    shot, result = make_run(count=4, size=(24, 32))
    own = replace(shot, name="one"), replace(shot, name="other")
    whole = summed(own, "one and 1 more")
    noisier = replace(result, views=result.views + np.float32(0.05))
    both = merged([result, noisier], [one.name for one in own], (), result.seconds)
    folder = write_run(tmp_path_factory.mktemp("joint") / "run", whole, both, scene)
    return own, whole, folder, result


def test_each_exposure_has_figures_of_its_own_beside_those_of_all(joint):
    own, whole, folder, result = joint
    assert [one.name for one in read_report(folder).exposures] == ["one", "other"]
    found = evaluate(read_run(folder), ReferenceData(whole, noise=SensorNoise(0.01), exposures=own))
    first, second = found["exposures"]
    assert [(one["name"], one["first_view"], one["views"]) for one in (first, second)] == [
        ("one", 0, 4),
        ("other", 4, 4),
    ]
    scores = image_scores(result.views, own[0].truth.views)
    assert first["psnr_db"]["mean"] == pytest.approx(scores["psnr_db"]["mean"])
    assert second["psnr_db"]["mean"] < first["psnr_db"]["mean"]
    mean = (first["psnr_db"]["mean"] + second["psnr_db"]["mean"]) / 2
    assert found["psnr_db"]["mean"] == pytest.approx(mean)
    assert second["residual"]["rms"] > first["residual"]["rms"]
    assert second["residual"]["chi2_per_pixel"] > first["residual"]["chi2_per_pixel"]
    assert found["trajectory"]["nate"] is not None


def test_figures_of_an_exposure_need_only_its_own_truth(joint):
    own, _, folder, _ = joint
    shots = own[0], replace(own[1], truth=Truth())
    depth = np.ones((8, 24, 32), np.float32)
    found = evaluate(read_run(folder), ReferenceData(summed(shots, "both"), depth=depth, exposures=shots))
    assert found["psnr_db"] is None
    assert [one["psnr_db"] is None for one in found["exposures"]] == [False, True]
    assert all(one["depth"]["known_share"] == 1 for one in found["exposures"])


def test_masks_that_registration_corrected_are_those_of_each_exposure(joint, tmp_path):
    own, whole, folder, _ = joint

    def corrected(shot):
        copy = tmp_path / shot.name
        shutil.copytree(folder, copy)
        write_shots(copy / "registered.h5", [shot])
        return read_run(copy)

    run, evidence = read_run(folder), ReferenceData(whole, exposures=own)
    right = evaluate(run, evidence)["exposures"]
    believed = tuple(replace(one, masks=np.ascontiguousarray(one.masks[:, ::-1])) for one in own)
    found = evaluate(corrected(whole), replace(evidence, exposures=believed))["exposures"]
    assert [one["residual"]["rms"] for one in found] == pytest.approx([one["residual"]["rms"] for one in right])
    other_unit = replace(whole, measurement=2 * whole.measurement, name="twice")
    found = evaluate(corrected(other_unit), evidence)["exposures"]
    assert [one["residual"] for one in found] == [None, None]


def test_a_run_of_one_exposure_has_none(make_run, scene, tmp_path):
    shot, result = make_run(count=4, size=(24, 32))
    folder = write_run(tmp_path / "run", shot, result, scene)
    assert evaluate(read_run(folder), ReferenceData(shot))["exposures"] == []


def test_standard_errors_follow_one_another_and_what_one_exposure_lacks_is_left_out(make_run):
    result = make_run(count=2)[1]
    maps = np.full(result.views.shape[:3], 0.1, np.float32)
    sure = Uncertainty(maps, maps, np.array([0.1, 0.2]), np.array([0.0, 0.01]))
    both = [replace(result, uncertainty=one) for one in (sure, replace(sure, views=2 * maps, rotations=None))]
    parts = side_by_side(iter(both), 4)
    found = merged(parts, ["one", "other"], (), result.seconds).uncertainty
    assert found.positions.tolist() == [0.1, 0.2] * 2
    assert found.rotations is None
    assert found.views[:, 0, 0].tolist() == [maps[0, 0, 0]] * 2 + [2 * maps[0, 0, 0]] * 2
    assert all(np.shares_memory(found.depth, part.uncertainty.depth) for part in parts)
    without = side_by_side(iter([both[0], replace(result, uncertainty=None)]), 4)
    assert merged(without, ["one", "other"], (), result.seconds).uncertainty is None
