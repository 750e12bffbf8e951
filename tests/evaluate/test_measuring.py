"""Lengths on a wall whose size is known, and what they are said to be worth."""

from dataclasses import replace

import numpy as np
import pytest

from gs2ci.core.errors import InputError
from gs2ci.evaluate.measuring import measure
from gs2ci.evaluate.pages.run_evidence import read_run
from gs2ci.evaluate.run_folder import write_run

pytestmark = pytest.mark.usefixtures("undrawn")

# Of the light; depth errs by 0.6 of it, and by what places that err by 0.25 px leave open.
SPREAD = 0.01
ERROR = 0.6 * SPREAD
PLACE_PX = 0.25


def error_of_depth(run, view, pixel):
    """As a share: by least squares from places in all views, whose common shift is not known."""
    column, row = pixel
    focal, middle = np.diag(run.intrinsics)[:2], run.intrinsics[:2, 2]
    ray = np.array([(column + 0.5 - middle[0]) / focal[0], (row + 0.5 - middle[1]) / focal[1], 1.0, 0.0])
    step, there = 1e-5, []
    for share in (-step, step):
        at = ray * run.depth[view, row, column] * (1 + share) + (0, 0, 0, 1)
        seen = np.array([pose @ np.linalg.inv(run.world_to_camera[view]) @ at for pose in run.world_to_camera])
        there.append(seen[:, :2] / seen[:, 2:3] * focal)
    design = (there[1] - there[0]) / (2 * step)
    shift = np.tile(np.eye(2), (len(design), 1))
    normal = np.linalg.inv(np.column_stack([design.ravel(), shift]).T @ np.column_stack([design.ravel(), shift]))
    return float(np.hypot(ERROR, PLACE_PX * np.sqrt(normal[0, 0])))


@pytest.fixture
def wall(make_run, scene, tmp_path):
    """A run before a wall at a depth of 4; make_run's pictures are 48 × 64 px with a focal length of 70.4 px."""
    shot, result = make_run(count=3)
    depth = np.full(result.depth.shape, 4.0, np.float32)
    # As of a run in which things move, whose depth has no standard errors.
    known = replace(
        result,
        depth=depth,
        depth_spread=np.full_like(depth, SPREAD),
        depth_confidence=np.full_like(depth, 0.9),
        uncertainty=None,
    )
    return read_run(write_run(tmp_path / "run", shot, known, scene))


def test_a_length_on_a_wall_is_that_of_its_pixels(wall):
    found = measure(wall, (10, 20), (50, 20), 1)
    assert found.length == pytest.approx(40 * 4 / 70.4, rel=1e-6)
    assert found.unit == "scene units"
    assert found.confidence == pytest.approx((0.9, 0.9))
    assert np.linalg.norm(found.points[1] - found.points[0]) == pytest.approx(found.length)


def test_the_standard_error_is_that_of_repeated_measurements(wall):
    rng = np.random.default_rng(0)
    stated, lengths = measure(wall, (10, 12), (50, 40), 0), []
    error = np.zeros(wall.depth.shape)
    for column, row in ((10, 12), (50, 40)):
        error[0, row, column] = error_of_depth(wall, 0, (column, row))
    for _ in range(3000):
        moved = wall.depth * (1 + error * rng.standard_normal(wall.depth.shape)).astype(np.float32)
        cameras = wall.intrinsics.copy()
        lengths.append(measure(replace(wall, depth=moved, intrinsics=cameras), (10, 12), (50, 40), 0).length)
    within_pixel = 4 / 70.4 / 12**0.5
    expected = np.hypot(np.std(lengths), 2**0.5 * within_pixel)
    assert stated.standard_error == pytest.approx(expected, rel=0.05)


def test_standard_errors_of_depth_are_taken_where_the_run_has_them(wall):
    column, row = 10, 12
    known = replace(wall, depth_error=np.full_like(wall.depth, 0.2))
    aside = measure(known, (column, row), (50, row), 0)
    focal, middle = np.diag(wall.intrinsics)[:2], wall.intrinsics[:2, 2]
    rays = np.array([[(x + 0.5 - middle[0]) / focal[0], (row + 0.5 - middle[1]) / focal[1], 1] for x in (column, 50)])
    line = rays[1] - rays[0]
    along = 0.2 * rays @ line / np.linalg.norm(line)
    within_pixel = 2**0.5 * 4 / 70.4 / 12**0.5
    assert aside.standard_error == pytest.approx(np.hypot(np.linalg.norm(along), within_pixel), rel=1e-6)


def test_nothing_is_added_for_a_given_unit_to_standard_errors_that_contain_it(wall):
    runs = [along_a_line(wall, np.array([1.0, 0, 0]), unit_of) for unit_of in ("stage", None)]
    errors = [
        measure(replace(run, depth_error=np.full_like(run.depth, 0.2)), (10, 20), (50, 20), 0).standard_error
        for run in runs
    ]
    assert errors[0] == errors[1]


def along_a_line(wall, way, unit_of="stage", count=8):
    """The wall seen by cameras along a line, whose poses were given."""
    poses = np.tile(np.eye(4), (count, 1, 1))
    poses[:, :3, 3] = np.linspace(-0.2, 0.2, count)[:, None] * way
    geometry = replace(wall.report.geometry, unit_of=unit_of)
    report = wall.report.model_copy(update={"geometry": geometry})
    maps = {
        name: np.repeat(getattr(wall, name)[:1], count, axis=0)
        for name in ("depth", "depth_spread", "depth_confidence")
    }
    return replace(wall, report=report, world_to_camera=poses, **maps)


def test_turns_of_given_cameras_make_all_lengths_in_their_unit_unsure(wall):
    rng, ends, turn = np.random.default_rng(0), ((2, 24), (60, 24)), 0.1 / 70.4
    run = along_a_line(wall, (1.0, 0, 0))
    stated = measure(run, *ends, 4).standard_error
    alone = measure(along_a_line(wall, (1.0, 0, 0), unit_of=None), *ends, 4)
    places = PLACE_PX / (70.4 / 4 * np.sqrt(np.square(np.linspace(-0.2, 0.2, 8)).sum()))
    # The inverse depth of the wall by least squares, from pictures that the cameras' turns displace.
    travel = run.world_to_camera[:, 0, 3]
    seen = 0.25 * travel + turn * rng.standard_normal((4000, len(travel)))
    scales = 4 * (seen @ (travel - travel.mean())) / np.square(travel - travel.mean()).sum()
    together = np.hypot(scales.std(), places)
    assert stated == pytest.approx(np.hypot(alone.standard_error, alone.length * together), rel=0.05)
    assert stated > 1.2 * alone.standard_error


def test_a_camera_at_rest_gives_lengths_no_unit_to_err_in(wall):
    still = [
        measure(along_a_line(wall, (0, 0, 0), unit_of), (2, 24), (60, 24), 4).standard_error
        for unit_of in ("file", None)
    ]
    assert still[0] == still[1]


def test_no_turn_looks_like_travel_along_the_line_of_sight(wall):
    run, alone = (along_a_line(wall, (0, 0, 1.0), unit_of) for unit_of in ("file", None))
    ends = ((2, 24), (60, 24))
    found, local = measure(run, *ends, 4), measure(alone, *ends, 4)
    of_all = np.sqrt(found.standard_error**2 - local.standard_error**2) / local.length
    # A point at r px from the axis moves by r t / z.
    rows, columns = np.mgrid[:48, :64] + 0.5
    away = np.median(np.hypot(columns - 32, rows - 24)) / 4
    # The middle view is a half step off the middle of the path: 1 % of the depth.
    assert of_all == pytest.approx(PLACE_PX / (away * np.sqrt(np.square(np.linspace(-0.2, 0.2, 8)).sum())), rel=0.05)
    untracked = run.report.model_copy(update={"geometry": replace(run.report.geometry, tracks=0)})
    unsure = measure(replace(run, report=untracked), *ends, 4).standard_error
    assert np.sqrt(unsure**2 - local.standard_error**2) / local.length == pytest.approx(4 * of_all)


def test_a_point_that_hardly_moves_through_the_views_has_an_uncertain_depth(wall):
    run, stated = along_a_line(wall, (0, 0, 1.0), None), []
    for column in (36, 62, 32):
        depth = run.depth.copy()
        depth[4, 25, column] = 8.0  # so that the line lies along the ray
        far = replace(run, depth=depth)
        stated.append(measure(far, (column, 24), (column, 25), 4).standard_error)
        if column != 32:
            errors = [4 * error_of_depth(far, 4, (column, 24)), 8 * error_of_depth(far, 4, (column, 25))]
            assert stated[-1] == pytest.approx(np.hypot(*errors), rel=0.1)
    assert stated[0] > 5 * stated[1]
    # None errs by more than itself.
    assert stated[2] < 1.5 * np.hypot(4, 8)


@pytest.mark.parametrize("tilt_deg", [0.0, 30.0, 60.0])
def test_the_places_within_pixels_lie_on_the_surface_as_it_is_slanted(wall, tilt_deg):
    normal, at_4 = np.array([np.sin(np.radians(tilt_deg)), 0.0, np.cos(np.radians(tilt_deg))]), np.array([0, 0, 4.0])
    focal, middle = np.diag(wall.intrinsics)[:2], wall.intrinsics[:2, 2]

    def seen(pixels):
        rays = np.concatenate([(pixels - middle) / focal, np.ones((*pixels.shape[:-1], 1))], axis=-1)
        return rays * (normal @ at_4 / (rays @ normal))[..., None]

    rows, columns = np.mgrid[:48, :64] + 0.5
    depth = np.broadcast_to(seen(np.stack([columns, rows], axis=-1))[..., 2], wall.depth.shape)
    # So far apart that places in the views leave nothing of depth open.
    apart = np.tile(np.eye(4), (3, 1, 1))
    apart[:, 0, 3] = (-1e4, 0, 1e4)
    exact = {"world_to_camera": apart, "depth_spread": np.zeros_like(wall.depth)}
    sure = replace(wall, depth=depth.astype(np.float32), **exact)
    rng = np.random.default_rng(0)
    off = []
    for _ in range(300):
        ends = np.stack([rng.integers((25, 1), (34, 47)), rng.integers((48, 1), (62, 47))])
        found = measure(sure, *(tuple(end) for end in ends), 1)
        one, other = seen(ends + rng.random((2, 2)))
        off.append((np.linalg.norm(other - one) - found.length) / found.standard_error)
    assert np.sqrt(np.mean(np.square(off))) == pytest.approx(1, abs=0.12)


def test_a_line_along_the_ray_is_as_unsure_as_both_depths(wall):
    depth = wall.depth.copy()
    depth[0, 24, 33] = 8.0
    # Next to the axis: 4 and 8 away.
    far = replace(wall, depth=depth)
    errors = [distance * error_of_depth(far, 0, pixel) for distance, pixel in ((4, (32, 24)), (8, (33, 24)))]
    assert measure(far, (32, 24), (33, 24), 0).standard_error == pytest.approx(np.hypot(*errors), rel=0.05)


@pytest.mark.parametrize(
    ("unit_of", "source", "unit"),
    [
        ("stage", "rig", "mm"),
        ("stage", "simulated rig", "units of the stage"),
        ("stage", "simulated exposure (gs2ci_sims)", "units of the stage"),
        ("stage", "foreign.mat", "units of the stage"),
        ("stage", None, "units of the stage"),
        ("file", "rig", "units of the file"),
        (None, "rig", "scene units"),
    ],
)
def test_lengths_are_in_millimetres_only_if_the_stage_of_a_rig_reported_the_path(wall, unit_of, source, unit):
    told = wall.report.model_copy(
        update={
            "geometry": replace(wall.report.geometry, unit_of=unit_of),
            "provenance": {} if source is None else {"source": source},
        }
    )
    assert measure(replace(wall, report=told), (1, 1), (5, 5), 0).unit == unit


def test_lengths_of_a_simulated_rig_are_in_its_scenes_units_of_so_many_millimetres(wall):
    told = wall.report.model_copy(
        update={
            "geometry": replace(wall.report.geometry, unit_of="stage"),
            "provenance": {"source": "simulated rig", "telemetry": {"unit_mm": 50.0}},
        }
    )
    assert measure(replace(wall, report=told), (1, 1), (5, 5), 0).unit == "units of 50 mm"


def test_lengths_of_a_run_without_geometry_are_in_units_of_the_scene(wall):
    told = wall.report.model_copy(update={"geometry": None, "provenance": {"source": "rig"}})
    assert measure(replace(wall, report=told), (1, 1), (5, 5), 0).unit == "scene units"


def test_pixels_are_whole_numbers_of_any_kind(wall):
    expected = measure(wall, (10, 20), (50, 20), 1)
    found = measure(wall, np.array([10, 20]), [np.int16(50), np.uint8(20)], 1)
    assert (found.length, found.standard_error) == (expected.length, expected.standard_error)


def test_what_cannot_be_measured_is_refused(wall):
    with pytest.raises(InputError, match=r"pixel 64,3.*columns 0 to 63, rows 0 to 47"):
        measure(wall, (64, 3), (1, 1), 0)
    with pytest.raises(InputError, match="pixel 2,-1"):
        measure(wall, (1, 1), (2, -1), 0)
    with pytest.raises(InputError, match="both ends are pixel 32,24; allowed: two pixels"):
        measure(wall, (32, 24), np.array([32, 24]), 0)
    with pytest.raises(InputError, match=r"view 4.*1 to 3"):
        measure(wall, (1, 1), (2, 2), 3)
    for other in ((10.0, 10.0), ("a", "b"), (1, 2, 3), (1, (2, 3)), 10, None):
        with pytest.raises(InputError, match=r"pixel .*; allowed: columns 0 to 63, rows 0 to 47.*whole numbers"):
            measure(wall, (1, 1), other, 0)
    hole = wall.depth.copy()
    hole[1, 5, 6] = 0
    with pytest.raises(InputError, match="nothing is seen at pixel 6,5 of view 2"):
        measure(replace(wall, depth=hole), (6, 5), (1, 1), 1)
    with pytest.raises(InputError, match="no depth with its spread"):
        measure(replace(wall, depth_spread=None), (1, 1), (2, 2), 0)


@pytest.mark.parametrize("verdict", ["rotation_only", "static", "unsupported"])
def test_without_a_camera_path_there_is_no_length(wall, verdict):
    geometry = replace(wall.report.geometry, verdict=verdict)
    told = replace(wall, report=wall.report.model_copy(update={"geometry": geometry}))
    with pytest.raises(InputError, match=r"no camera path was found.*sideways.*--geometry"):
        measure(told, (10, 20), (50, 20), 1)
