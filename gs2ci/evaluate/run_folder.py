"""The run folder: all results of one reconstruction, written completely or not at all.

    run/
      report.json    the figures, schema gs2ci.report/2 (gs2ci.evaluate.report)
      report.html    the page to look at first (gs2ci.evaluate.pages)
      overview.png   one picture of the run
      given.npz      the parts of the shot that the page shows: 8-bit measurement and truth, true and stage's poses
      views.npy      the recovered views, [N, H, W, 3] float32, full scale 1, not clamped; mono repeated thrice
      views/         the same as 8-bit pictures, clamped to [0, 1]; mono stays grey
      decode.npy     the views of the decode alone, as views.npy
      scene_views.npy  the Gaussians rendered, without refinement, as views.npy
      exposed_views.npy  only if masks were fitted with moments: the light during each mask's time, as views.npy
      depth.npy      [N, H, W] float32, the unit of the path, 0 at pixels without a depth; if no path was found
                     (`geometry.verdict`), where the fit left the Gaussians, which says nothing of the scene
      depth_spread.npy      the same shape: spread along the ray of where the light is absorbed, as a share of depth
      depth_confidence.npy  the same shape: the share of a pixel's light that is absorbed within 5 % of its depth
      depth_error.npy  standard error of depth, in its unit, [N, H, W] float32; absent without a path, or if things move
      depth_other.npy  depth with near and far exchanged, not fitted, where the report says that their order is open
      views_error.npy  standard error of the views' values, full scale 1, [N, H, W] float32
      disagreement.npy  [N, H, W] float32, full scale 1: difference between the fits; absent if there was one
      scene.ply      the Gaussians, 3DGS convention; if they move, at the middle of the exposure; with the standard
                     errors of their centres, `standard_error`, if depth has any
      motion.npy     only if they move: [G, K, 3] float32, in their order, the unit of the path; at time t, from −1
                     to 1 over the exposure, a centre is at its place plus sum_k motion_k t^k, k = 1 ... K
      displacement.npy  likewise: [H, W, 2] float32, displacement over the exposure of what each pixel shows, px
      motion.png     the same in one picture
      moments/       only on request: pictures spread over the exposure, and a scene file of each if things move
      points.ply     points of the surfaces that the views see: normals, colours, confidence; if things move, those of
                     the middle view alone; absent without a path
      cameras.json   nerfstudio transforms
      colmap/sparse/0  the same cameras, and a thinned cloud of the Gaussians' centres
      registered.h5  only if registration corrected something: the corrected measurement, used from then on
      registration.png  the same in one picture: the masks' calibrated and estimated positions; not of a joint run
      tradeoff.json  only if `gs2ci tradeoff --report` added it: accuracy against time for this shot

Not here: the figures, the page, the picture.
"""

from pathlib import Path
from typing import Final

import numpy as np
import torch

from gs2ci.core.arrays import F32
from gs2ci.core.findings import Code
from gs2ci.core.json_text import as_json
from gs2ci.core.records import Shot
from gs2ci.core.run_records import RunResult
from gs2ci.core.storage import write_shots
from gs2ci.evaluate.cameras import nerfstudio_transforms, write_colmap_model
from gs2ci.evaluate.moments import MOMENTS_NAME, render_moments
from gs2ci.evaluate.moments import moments as moment_times
from gs2ci.evaluate.overview import write_overview
from gs2ci.evaluate.pages.run_evidence import GIVEN_NAME, write_given
from gs2ci.evaluate.pages.run_page import write_run_page
from gs2ci.evaluate.points import Cameras, of_one_moment, points_of, write_points
from gs2ci.evaluate.report import EXPOSED_NAME, MOTION_PICTURE_NAME, REGISTERED_NAME, Report
from gs2ci.evaluate.run_report import build_report
from gs2ci.evaluate.sureness import DEPTH_OTHER, errors_of_centres, in_other_order, write_errors
from gs2ci.evaluate.whole_folder import REPORT_NAME, view_names, whole_folder, write_pictures
from gs2ci.render.gaussians import Gaussians
from gs2ci.render.harmonics import colours_from
from gs2ci.render.ply import write_ply

# Enough for a viewer to recognise the scene, few enough for text tools to stay usable.
COLMAP_POINTS: Final = 10_000


def write_run(
    folder: Path,
    shot: Shot,
    result: RunResult,
    scene: Gaussians,
    *,
    overwrite: bool = False,
    moments: int | None = None,
) -> Path:
    """Write a finished run; the folder appears complete or not at all.

    Args:
        folder: The folder; its parents are created.
        shot: The measurement that was reconstructed.
        result: The result.
        scene: The Gaussians, on the CPU.
        overwrite: Replace an earlier run at this place.
        moments: Also write this many pictures spread over the exposure.

    Returns:
        The folder.

    Raises:
        StorageError: The place holds something else, or the disk refuses.
        InputError: Parts of the result do not fit together, or the number of moments is out of range.
        NumericsError: The result holds numbers that are not finite.
    """
    result.check()
    folder = Path(folder)
    with whole_folder(folder, overwrite=overwrite) as partial:
        report = build_report(shot, result)
        _write_images(partial, result)
        if result.depth is not None and report.found(Code.DEPTH_ORDER_OPEN):
            np.save(partial / DEPTH_OTHER, in_other_order(result.depth))
        _write_scene(partial, result, report, scene)
        _write_motion(partial, result, scene)
        if moments is not None:
            _write_moments(partial, shot, result, scene, moments)
        write_overview(partial / "overview.png", shot, result, report)
        (partial / REPORT_NAME).write_text(report.text(), encoding="utf-8")
        write_given(partial / GIVEN_NAME, shot)
        if result.registered is not None:
            write_shots(partial / REGISTERED_NAME, [result.registered])
        if result.registered is not None and result.registration is not None:
            # Matplotlib takes longer to import than all else here, and few runs need it.
            from gs2ci.evaluate.drawings import write_registration_picture  # noqa: PLC0415

            write_registration_picture(partial / "registration.png", shot, result.registered, result.registration)
        write_run_page(partial)
    return folder


def _write_images(folder: Path, result: RunResult) -> None:
    _save_views(folder / "views.npy", result.views)
    _save_views(folder / "decode.npy", result.decode)
    _save_views(folder / "scene_views.npy", result.scene_views)
    if result.exposed_views is not None:
        _save_views(folder / EXPOSED_NAME, result.exposed_views)
    for name in ("depth", "depth_spread", "depth_confidence"):
        values = getattr(result, name)
        if values is not None:
            np.save(folder / f"{name}.npy", values.astype(np.float32, copy=False))
    write_errors(folder, result.uncertainty)
    if result.disagreement is not None:
        np.save(folder / "disagreement.npy", result.disagreement.astype(np.float32, copy=False))
    write_pictures(folder / "views", result.views)


def _write_scene(folder: Path, result: RunResult, report: Report, scene: Gaussians) -> None:
    size = (int(result.views.shape[1]), int(result.views.shape[2]))
    write_ply(folder / "scene.ply", scene, standard_errors=errors_of_centres(scene, result))
    poses, lens = result.world_to_camera, result.distortion
    if result.depth is not None and result.depth_confidence is not None and not report.lacks_path:
        seen = of_one_moment(len(poses), moves=scene.motion is not None)
        cameras = Cameras(poses[seen], result.intrinsics, lens)
        found = points_of(result.depth[seen], result.depth_confidence[seen], result.views[seen], cameras)
        write_points(folder / "points.ply", found)
    transforms = nerfstudio_transforms(poses, result.intrinsics, size, lens)
    (folder / "cameras.json").write_text(as_json(transforms), encoding="utf-8")
    model = folder / "colmap" / "sparse" / "0"
    model.mkdir(parents=True)
    # The most opaque Gaussians show the surfaces; a stable sort makes the choice among equal ones reproducible.
    keep = torch.argsort(scene.opacity_logits.detach(), descending=True, stable=True)[:COLMAP_POINTS]
    middle = torch.from_numpy(poses[len(poses) // 2])
    shown = (scene.means, colours_from(scene, middle))
    points, colors = (tensor.detach()[keep].float().numpy() for tensor in shown)
    # What moves is at no one place for several views to see.
    depth = None if scene.motion is not None or report.lacks_path else result.depth
    write_colmap_model(
        model,
        poses,
        result.intrinsics,
        size,
        points=points,
        colors=colors,
        distortion=lens,
        depth=depth,
        views=result.views,
    )


def _write_motion(folder: Path, result: RunResult, scene: Gaussians) -> None:
    if scene.motion is None or result.displacement is None:
        return
    np.save(folder / "motion.npy", scene.motion.detach().float().numpy())
    np.save(folder / "displacement.npy", result.displacement)
    from gs2ci.evaluate.drawings import write_motion_picture  # noqa: PLC0415  as above

    write_motion_picture(folder / MOTION_PICTURE_NAME, result.views[len(result.views) // 2], result.displacement)


def _write_moments(folder: Path, shot: Shot, result: RunResult, scene: Gaussians, count: int) -> None:
    times = moment_times(count)
    write_pictures(folder / MOMENTS_NAME, render_moments(shot, result, scene, times))
    if scene.motion is not None:
        for name, moment in zip(view_names(count), times, strict=True):
            write_ply(folder / MOMENTS_NAME / f"{Path(name).stem}.ply", scene.at(float(moment)))


def _save_views(path: Path, views: F32) -> None:
    """Write views as `np.save` does, mono repeated thrice: one at a time, since those of a joint run are many."""
    shape = (*views.shape[:3], 3)
    with path.open("wb") as file:
        np.lib.format.write_array_header_1_0(file, {"descr": "<f4", "fortran_order": False, "shape": shape})
        for view in views:
            file.write(np.ascontiguousarray(np.broadcast_to(view, shape[1:]), "<f4").data)
