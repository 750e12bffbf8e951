"""What cells do: plain arguments in, a row of figures out.

Not here: which of them a table needs (`tables`). Cells name these functions; nothing else calls them.
"""

from typing import Any

from gs2ci.bench.cases import Case
from gs2ci.bench.store import Row
from gs2ci.bench.variants import settings_of
from gs2ci.evaluate.report import build_report
from gs2ci.reconstruct.pipeline import reconstruct


def reconstruct_case(case: dict[str, Any], variant: str, seed: int) -> Row:
    """Reconstruct a case; figures in dB, full scales and seconds, None where no truth tells.

    Args:
        case: Fields of a `Case`.
        variant: A name in `variants.VARIANTS`.
        seed: Of masks, noise and the reconstruction's own draws.

    Raises:
        Gs2ciError: The case cannot be made, or not be reconstructed.
    """
    shot = Case.of(case).shot(seed)
    report = build_report(shot, reconstruct(shot, settings_of(variant, seed)).result)
    psnr, ssim, trajectory = report["psnr_db"], report["ssim"], report["trajectory"]
    decode_psnr = report["decode"]["psnr_db"]
    return {
        "psnr_db": psnr and psnr["mean"],
        "ssim": ssim and ssim["mean"],
        "nate": trajectory and trajectory["nate"],
        "decode_psnr_db": decode_psnr and decode_psnr["mean"],
        "heldout_rms": report["residual"]["heldout_rms"][report["verdict"]],
        "seconds": report["seconds"]["total"],
        "gaussians": report["gaussians"],
        "verdict": report["verdict"],
        "stopped_because": report["stopped_because"],
    }
