"""The figures of a run that matter, each with its name and what to compare it with: for a terminal, a notebook, a page.

Not here: any figure's computation.
"""

from dataclasses import asdict

from gs2ci.core.durations import spoken_duration
from gs2ci.evaluate.report import Report
from gs2ci.evaluate.trajectory import TrajectoryErrors
from gs2ci.evaluate.wording import describe_number


def summary_rows(report: Report) -> list[tuple[str, str, str]]:
    """Collect name, value and remark of every figure that is known."""
    rows = []
    for own, decode, name, form, unit in (
        (report.psnr_db, report.decode.psnr_db, "PSNR", "{:.2f}", " dB"),
        (report.ssim, report.decode.ssim, "SSIM", "{:.4f}", ""),
    ):
        if own is not None and decode is not None:
            values = (min(own.per_view), own.mean, max(own.per_view), decode.mean)
            low, mean, high, of_decode = (form.format(value) for value in values)
            rows.append((name, mean + unit, f"decode {of_decode}; views {low} to {high}"))
    rows += _trajectory_rows(report.trajectory)
    if report.depth is not None:
        rows.append(("depth", *report.depth.in_words()))
    residual = report.residual
    rows.append(("residual", f"{residual.rms:.4f} rms", f"{residual.mean_abs:.4f} mean absolute"))
    if report.heldout_rms is not None:
        others = [(name, rms) for name, rms in asdict(residual.heldout_rms).items() if name != report.verdict]
        remark = ", ".join(f"{name} {rms:.4f}" for name, rms in others if rms is not None)
        rows.append(("held-out", f"{report.heldout_rms:.4f} rms", remark))
    seconds = report.seconds
    told = ("registration", "decode", "geometry", "fit")
    stages = ", ".join(f"{stage} {seconds[stage]:.1f} s" for stage in told if stage in seconds)
    rows.append(("time", spoken_duration(seconds["total"]), stages))
    rows.append(("Gaussians", describe_number(report.gaussians), f"peak memory {report.peak_mib:.0f} MiB"))
    return rows


def _trajectory_rows(errors: TrajectoryErrors | None) -> list[tuple[str, str, str]]:
    if errors is None:
        return []
    rows = []
    if errors.nate is not None:
        backwards = "; runs opposite to the true path" if errors.reversed else ""
        rows.append(("nATE", f"{errors.nate:.4f}", f"ATE {errors.ate:.4g}{backwards}"))
    remark = "" if errors.rpe_r_deg is None else f"RPE {errors.rpe_t:.4g}, {errors.rpe_r_deg:.3f}°"
    rows.append(("rotation", f"{errors.rotation_deg:.3f}°", remark))
    return rows
