"""The delivered views: those of the fits, of the best scene and of the decode, combined for the least expected error.

    mean of the fits ─┬─ with its residual put back ──────┬───────────────────┐
                      │                                   └─ and polished ────┤
                      └─ as it is ────────────────────────────────────────────┤
    best scene ───────────────────────────────────────────────────────────────┼─► weights by held-out pixels
    decode (unless far off) ──────────────────────────────────────────────────┘   ─► the combination, from all pixels

Where the fits' views surely err over time and those of the decode do not, the latter take their place first.

Polishing is a decode by groups of similar patches that starts from the refined views: it adds detail that the scene
lacks, and follows moving things.

Here: the candidates, the name of the result, and how long polishing takes. Not here: their weights
(`fit/combining/combination.py`), the fits (`hypotheses`), the order of the stages (`pipeline`).
"""

import math
import time
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Final, Literal

import numpy as np
import torch

from gs2ci.core.arrays import F32
from gs2ci.core.findings import Code, Findings, finding
from gs2ci.core.run_figures import Verdict
from gs2ci.reconstruct.choices import LeftOut
from gs2ci.reconstruct.decode.gap_tv import decode_weighing, gap_tv
from gs2ci.reconstruct.decode.patches.decoder import PatchSettings, patch_decode_from, seen_to_the_end
from gs2ci.reconstruct.first_look import FirstLook
from gs2ci.reconstruct.fit.combining.combination import LEAST_SHARE, Candidate, combined, expected_rms, shares
from gs2ci.reconstruct.fit.combining.ensemble import Ensemble
from gs2ci.reconstruct.fit.combining.refinement import Refinement
from gs2ci.reconstruct.fit.scene.rendering import ShotRenderer
from gs2ci.reconstruct.measurement.doubts import doubts_about_result
from gs2ci.reconstruct.measurement.holdout import Holdout, surely_larger
from gs2ci.reconstruct.measurement.noise import followed, mean_power, noise_of_readings
from gs2ci.reconstruct.measurement.over_time import followed_by_other_alone, replaced
from gs2ci.reconstruct.settings import Settings

# A decode whose held-out residual is so many times that of the fits' mean would get a weight of a few hundredths at
# most, and the candidates made from it cost several decodes' time.
_FAR_OFF: Final = 1.7
# The expected error, rms in full scales, from which on the report doubts the views. An error of 0.05 (26 dB) is visible
# at a glance; with little noise the expectation is 0.84 to 1 times the error (docs/decisions/combination.md).
_ERRS: Final = 0.045
# If candidates of one kind have at least this weight together, the result is made of them alone and named after them.
_ALL_BUT: Final = 1 - LEAST_SHARE

Part = Literal["refined", "polished", "mean", "scene", "decode"]
_CALLED: Final[dict[Part, Verdict]] = {
    "refined": "refined",
    "polished": "refined",
    "mean": "refined",
    "scene": "scene",
    "decode": "decode",
}


@dataclass(frozen=True)
class Recovered:
    """The delivered views, what they are made of, and the held-out residuals that led to them."""

    views: F32
    verdict: Verdict
    heldout_rms: dict[Verdict, float | None]
    notes: Findings
    exposed: F32 | None = None
    """What each mask saw, averaged over the time it was displayed, if `views` show the middle of that time."""
    scene_views: F32 | None = None
    """Views of the best scene at the middle of each mask's time; None: those of the fit."""
    parts: Mapping[Verdict, float] = field(default_factory=dict)
    """The share of each in the views."""

    @property
    def is_decode(self) -> bool:
        """Get whether the views are almost entirely those of the decode."""
        return self.verdict == _CALLED["decode"]

    @property
    def is_refined(self) -> bool:
        """Get whether they are a combination with the mean of the fits."""
        return self.verdict == _CALLED["refined"]

    def in_the_middle(self, ensemble: Ensemble, renderer: ShotRenderer) -> "Recovered":
        """Return the views at the middle of each mask's time.

        The views are corrected by the difference between the scenes' renderings at the middle and over the whole time:
        the best scene's share by its own difference, that of refined views, which are made of all averaged fits, by the
        mean of theirs. The decode's share is not corrected, since it has no camera path.
        """
        if renderer.moments_per_mask == 1:
            return self
        averaged = (ensemble.best, *ensemble.others)[: max(ensemble.averaged, 1)]
        differ = [
            renderer.views(fit.scene, torch.from_numpy(fit.world_to_camera).float(), renderer.times) - fit.views
            for fit in averaged
        ]
        by_mean, by_scene = (np.float32(self.parts.get(name, 0.0)) for name in ("refined", "scene"))
        views = self.views + by_mean * np.mean(differ, axis=0, dtype=np.float32) + by_scene * differ[0]
        return replace(self, views=views, exposed=self.views, scene_views=ensemble.best.views + differ[0])


def hand_over(
    first: FirstLook,
    ensemble: Ensemble,
    refine: Refinement,
    settings: Settings,
    polishing: tuple[PatchSettings, ...],
) -> Recovered:
    """Combine the fits' mean, with and without its residual, the best scene's views and the decode's.

    If the settings decode no residual, or no pixel was held out, the best scene's views are returned unchanged.

    Args:
        first: The measurement with its held-out pixels, and its decode.
        ensemble: Of the fits.
        refine: Adds the decoded residual to views.
        settings: Of the reconstruction.
        polishing: Schedules of a decode by similar patches that starts from the refined views, for scenes in which
            things move and which Gaussians explain in part only; the result of each is kept if it lowers the residual
            at the held-out pixels.
    """
    holdout, own, mean = first.holdout, ensemble.best.views, ensemble.views
    if settings.residual is None or not holdout.pixels.any():
        judged = _judged(holdout, {"refined": own, "scene": own, "decode": first.decoded})
        return Recovered(own, "scene", judged, _doubts(holdout, own), parts={"scene": 1.0})
    unfollowed = followed_by_other_alone(holdout, mean, first.decoded)
    if LeftOut.ERRORS_OVER_TIME in settings.left_out:
        unfollowed = np.zeros_like(unfollowed)
    if unfollowed.any():
        own, mean = (replaced(views, first.decoded, unfollowed) for views in (own, mean))
    noise_by_reading, by_factor = _noise(first, ensemble.views, settings)
    least_noise = mean_power(noise_by_reading, holdout)
    noise = least_noise * by_factor
    refine = replace(refine, noise=noise_by_reading)
    in_full, by_share = refine.in_full_and_by_share(mean)
    dense = () if LeftOut.DENSE_POLISH in settings.left_out else polishing
    refined_views, notes = _polished_densely(holdout, by_share, dense)
    polished_so_far = by_share if refined_views is None else refined_views.blind
    del by_share  # here and below, what is as large as the views goes when it has done its part
    if refined_views is None:
        refined_views = Candidate(in_full, refine.by_all_pixels(mean))
    cancels = bool(notes) and LeftOut.CANCELLING_ERRORS not in settings.left_out
    candidates: dict[Part, Candidate] = {
        "refined": refined_views,
        # If patches, which may move, reduced the residual much, the scenes explain the sum of views, not each view:
        # their errors cancel along the views.
        "mean": Candidate(mean, mean, cancels=cancels),
        "scene": Candidate(own, own, cancels=cancels),
    }
    near = (holdout.residual_rms(first.decoded) or 0.0) < _FAR_OFF * (holdout.residual_rms(mean) or 0.0)
    decode: dict[Part, Candidate] = {"decode": Candidate(first.decoded, first.decoded)} if near else {}
    # If the decode has nearly all the weight, the scene shows something else, and polishing it would give little more
    # than another decode. The least noise decides: detail that the scene lacks, and polishing adds, may look like more.
    alone = shares(holdout, {**candidates, **decode}, least_noise).get("decode", 0.0) >= _ALL_BUT
    if settings.polish is not None and not alone:
        candidates["polished"] = _polished(holdout, polished_so_far, settings.polish, noise_by_reading)
    del polished_so_far
    if near and (first.sigma is None or shares(holdout, {**candidates, **decode}, noise)["decode"] > 0):
        candidates["decode"] = _decoded(first, settings, noise_by_reading)
    wanted = shares(holdout, candidates, noise)
    candidates = {name: one for name, one in candidates.items() if wanted[name] > 0}
    blind = combined({name: one.blind for name, one in candidates.items()}, wanted)
    judged = _judged(holdout, {"refined": blind, "scene": ensemble.best.views, "decode": first.decoded})
    doubts = _doubts(holdout, blind)
    del refined_views, decode, blind
    of: dict[Verdict, float] = {"refined": 0.0, "scene": 0.0, "decode": 0.0}
    for name, share in wanted.items():
        of[_CALLED[name]] += share
    verdict: Verdict = next((name for name, share in of.items() if share >= _ALL_BUT), "refined")
    if verdict == "scene" and unfollowed.any():
        verdict = "refined"
    if verdict != "refined":
        wanted = {name: share / of[verdict] if _CALLED[name] == verdict else 0.0 for name, share in wanted.items()}
        of, notes = {verdict: 1.0}, ()
    elif of["refined"] < 1:
        mixed = finding(Code.VIEWS_COMBINED, refined=of["refined"], scene=of["scene"], decode=of["decode"])
        notes = (*notes, mixed)
    notes = (*notes, *_of_patches_and_decode(wanted.get("polished", 0.0), float(unfollowed.mean())))
    given = Candidate(
        combined({name: one.blind for name, one in candidates.items()}, wanted),
        combined({name: one.full for name, one in candidates.items()}, wanted),
    )
    notes = (*doubts, *_expected_to_err(holdout, given, least_noise), *notes)
    return Recovered(given.full, verdict, judged, notes, parts=of)


def _noise(first: FirstLook, views: F32, settings: Settings) -> tuple[F32, float]:
    """Return the noise of the readings, [H, W, C], as scenes' views, [N, H, W, C], tell it; and a factor on its mean.

    Where they surely explain less than the decode, much of what they leave is no noise: as much is as a decode had
    better weigh.
    """
    holdout = first.holdout
    found = noise_of_readings(holdout, views)
    fails = surely_larger(holdout.squared_residuals(views), holdout.squared_residuals(first.decoded))
    if not fails or LeftOut.DECODE_WEIGHS_NOISE in settings.left_out:
        return found, followed(holdout, views)
    return decode_weighing((holdout, *holdout.beside), settings.decode, found)[1], 1.0


def _of_patches_and_decode(polished: float, unfollowed: float) -> Findings:
    """Report the share of views made by patches, and that replaced by the decode because it errs over time."""
    of_patches = (finding(Code.VIEWS_OF_PATCHES, share=polished),) if polished > 0 else ()
    return (*of_patches, finding(Code.SCENE_NOT_FOLLOWING, share=unfollowed)) if unfollowed > 0 else of_patches


def _expected_to_err(holdout: Holdout, given: Candidate, noise: float) -> Findings:
    """Report the expected error of views if it is large enough to be visible; too much noise would hide it."""
    rms = expected_rms(holdout, given, noise)
    if rms is None or rms < _ERRS:
        return ()
    return (finding(Code.VIEWS_ERR, share=rms, psnr_db=-20 * math.log10(rms)),)


def _judged(holdout: Holdout, views: dict[Verdict, F32]) -> dict[Verdict, float | None]:
    return {name: holdout.residual_rms(one) for name, one in views.items()}


def _doubts(holdout: Holdout, views: F32) -> Findings:
    return doubts_about_result(holdout, views) if holdout.pixels.any() else (finding(Code.UNJUDGED),)


def _polished_densely(
    holdout: Holdout, refined: F32, polishing: tuple[PatchSettings, ...]
) -> tuple[Candidate | None, Findings]:
    """Polish refined views, [N, H, W, C], by the schedules in turn; None if none of them lowers the held-out residual.

    A few last steps then use all pixels, those held out included.
    """
    polished = refined
    after = before = holdout.residual_rms(refined) or 0.0
    for steps in polishing:
        further = patch_decode_from(holdout.every_seen, polished, steps)
        left = holdout.residual_rms(further) or 0.0
        if left < after:
            polished, after = further, left
    if after >= before:
        return None, ()
    full = patch_decode_from(holdout.every_shot, polished, PatchSettings.to_the_end())
    return Candidate(polished, full), (finding(Code.VIEWS_POLISHED, before=before, after=after),)


def _polished(holdout: Holdout, refined: F32, how: PatchSettings, noise: F32) -> Candidate:
    """Decode by patches, starting from refined views, [N, H, W, C]; a few last steps use all pixels."""
    blind = patch_decode_from(holdout.every_seen, refined, how, noise=noise)
    return Candidate(blind, patch_decode_from(holdout.every_shot, blind, how.last_steps, noise=noise))


def polish_seconds(holdout: Holdout, views: F32, how: PatchSettings) -> float:
    """Return how long polishing will take, from the time of its first step.

    Args:
        holdout: The measurement.
        views: To begin with, [N, H, W, C]; a step takes about the same time whatever they show.
        how: The schedule.
    """
    began_s = time.monotonic()
    patch_decode_from(holdout.every_seen, views, replace(how, iterations=1))
    return (how.iterations + how.last_steps.iterations) * (time.monotonic() - began_s)


def _decoded(first: FirstLook, settings: Settings, noise: F32) -> Candidate:
    """Decode from all pixels.

    The noise of the readings, [H, W, C], is weighed if that lowers the held-out residual: where a scene lacks much,
    noise is overestimated. A brief decode by patches is first continued on the long schedule of the settings. The
    caller skips all this if a decode by patches gets no weight as it is.
    """
    holdout = first.holdout
    if first.is_decoded_briefly and settings.long_decode is not None:
        longer = first.decoded_longer(settings.long_decode, hurried=True)
        if (holdout.residual_rms(longer.decoded) or 0.0) < (holdout.residual_rms(first.decoded) or 0.0):
            first = longer
    if first.sigma is not None:
        return Candidate(first.decoded, seen_to_the_end(holdout, first.decoded, first.sigma))
    decoded, known = first.decoded, first.noise
    if LeftOut.DECODE_WEIGHS_NOISE not in settings.left_out:
        weighed = gap_tv(holdout.every_seen, settings.decode, noise=noise)
        if (holdout.residual_rms(weighed) or 0.0) < (holdout.residual_rms(first.decoded) or 0.0):
            decoded, known = weighed, noise
    return Candidate(decoded, gap_tv(holdout.every_shot, settings.decode, noise=known))
