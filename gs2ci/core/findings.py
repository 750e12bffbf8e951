"""Everything that a reconstruction may find worth telling: one code, one sentence and one remedy for each.

Here: the registry, `Code`, and `Finding`, one of its entries with its figures. Records hold findings; pages, the
overview, the terminal and tests read their codes. `docs/findings.md` lists them all (`python -m tests.docs`). Not here:
errors, which end a command (`gs2ci.core.errors`).
"""

import enum
import string
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Self

Figure = float | int | str | list[int]


class Weight(StrEnum):
    """How much a finding matters."""

    REMARK = "remark"
    """Worth knowing; nothing needs to be done, though the remedy may help."""
    DOUBT = "doubt"
    """Part of the result is not to be relied on, or not as far as usual."""
    FAILURE = "failure"
    """Something that was asked for could not be done, and the result is without it."""


REMARK, DOUBT, FAILURE = Weight.REMARK, Weight.DOUBT, Weight.FAILURE
_NOTHING = "Nothing needs to be done."
_MORE_POINTS = (
    "Use more light, fewer masks in one exposure or a scene with more texture; see with `gs2ci decode` whether there "
    "is anything to follow."
)
_MOVE = "Move the camera sideways while the masks change: depth is read from the shift of near against far."
_MASKS = "Check that the masks are those of this exposure, in its order (`gs2ci import --masks`, `--reverse-masks`)."
_SCALE = "Give the readings of darkness and of a white scene under one open mask: `gs2ci import --offset --scale`."
_FOCAL = "Give it if you know it: `gs2ci reconstruct --focal-px`."
_RELY_NOT = (
    "Do not rely on path and depth, even where the views are good. More sideways motion, texture over more of the "
    "frame, or a stage that reports its poses would help."
)
_RIGID = "Check that nothing but the camera moved, and that the camera matrix is right (`gs2ci import --intrinsics`)."
_POSES = (
    "Check that the poses are world-to-camera with OpenCV axes, in the order of the masks; or find them from the "
    "views: `gs2ci reconstruct --geometry tracks`."
)


@enum.unique
class Code(StrEnum):
    """A kind of finding.

    Attributes:
        weight: How much it matters.
        sentence: What is said, with the names of its figures in braces.
        remedy: What can be done about it.
    """

    weight: Weight
    sentence: str
    remedy: str

    def __new__(cls, code: str, weight: Weight, sentence: str, remedy: str) -> Self:
        """Make a member from its code, its weight, its sentence and its remedy."""
        member = str.__new__(cls, code)
        member._value_ = code
        member.weight, member.sentence, member.remedy = weight, sentence, remedy
        return member

    @property
    def figures(self) -> frozenset[str]:
        """Get the names of the figures that the sentence holds."""
        return frozenset(name for _, name, _, _ in string.Formatter().parse(self.sentence) if name)

    # Why a fit ended.
    FIT_STALLED = (
        "fit_stalled",
        REMARK,
        "The fit ended because the held-out pixels stopped improving; they were best at iteration {best}.",
        "Nothing needs to be done: this is the usual end.",
    )
    FIT_ALL_DONE = (
        "fit_all_done",
        REMARK,
        "The fit ended because all {iterations} iterations were done; the held-out pixels were best at iteration "
        "{best}.",
        "If they were best near the end, let it run longer: `gs2ci reconstruct --iterations`.",
    )
    FIT_ALL_DONE_UNJUDGED = (
        "fit_all_done_unjudged",
        REMARK,
        "The fit ended because all {iterations} iterations were done; no pixels were held out to judge them.",
        "Choose the number of iterations yourself: `gs2ci reconstruct --iterations`.",
    )
    FIT_TIME_UP = (
        "fit_time_up",
        REMARK,
        "The fit ended because the time was up after {iterations} iterations; the held-out pixels were best at "
        "iteration {best}.",
        "If they were best near the end, give it more time: `gs2ci reconstruct --budget`.",
    )
    FIT_TIME_UP_UNJUDGED = (
        "fit_time_up_unjudged",
        REMARK,
        "The fit ended because the time was up after {iterations} iterations; no pixels were held out to judge them.",
        "Give it more time: `gs2ci reconstruct --budget`.",
    )
    FIT_INTERRUPTED = (
        "fit_interrupted",
        DOUBT,
        "The fit was interrupted after {iterations} iterations; its best state so far, that of iteration {best}, was "
        "kept.",
        "Reconstruct again and let it run to its end.",
    )
    INTERRUPTED = (
        "interrupted",
        DOUBT,
        "The reconstruction was interrupted: what had been found was handed over, and all that would have come after "
        "was left out.",
        "Reconstruct again and let it run to its end.",
    )
    FIT_DIVERGED = (
        "fit_diverged",
        FAILURE,
        "The fit ended because its numbers ran away {times} times; the state of iteration {best} was kept.",
        "Look for pixels that are broken rather than bright: `gs2ci import --bad-pixels median`.",
    )

    # The light of the measurement.
    EMPTY_MEASUREMENT = (
        "empty_measurement",
        FAILURE,
        "The measurement is {reading} everywhere: it shows no scene.",
        "Check that light reaches the sensor, and that the file's measurement was read: `gs2ci import --meas-key`.",
    )
    SATURATED = (
        "saturated",
        DOUBT,
        "{share:.0%} of the pixels are saturated and say only «at least».",
        "Use less light, or a shorter exposure.",
    )
    UNTOLD_CLIPPING = (
        "untold_clipping",
        DOUBT,
        "{share:.1%} of the pixels read the highest value, {reading:.4g}, and are taken for clipped, which nobody had "
        "told.",
        "Use less light, or a shorter exposure.",
    )
    UNIT_CORRECTED = (
        "unit_corrected",
        DOUBT,
        "The readings are {factor:.4g} times full scales of one view ({reason}); they were divided by it, and the "
        "views' brightness is known only so far.",
        _SCALE,
    )

    # The masks, as the measurement shows them.
    MASKS_TURNED = (
        "masks_turned",
        DOUBT,
        "The masks' pattern shows {how} against the file: its correlation has a peak of {ratio:.0f} times the "
        "thirtieth best place; the masks were turned.",
        "Check how the masks were written, or measure them anew: `gs2ci calibrate`.",
    )
    MASKS_BEGIN_ELSEWHERE = (
        "masks_begin_elsewhere",
        DOUBT,
        "Mask {first} of the list was shown first: beginning there, views differ the more the further apart in time "
        "they are (rank correlation {rank:.2f}), and as given they do not ({given:.2f}). The masks were taken in that "
        "order; weights and poses kept theirs.",
        "Check with which mask the exposure began, or how the masks were written.",
    )
    MASKS_CORRECTED = (
        "masks_corrected",
        DOUBT,
        "The masks were corrected by what the measurement tells: {found}.",
        "Measure the masks anew: `gs2ci calibrate`.",
    )
    MASKS_DIVIDED = (
        "masks_divided",
        DOUBT,
        "A fully open element was believed to let {opened:.3g} of the light through; by the measurement's unit it is "
        "all, and the masks were divided by that.",
        _SCALE,
    )
    RIM_GUESSED = (
        "rim_guessed",
        REMARK,
        "{share:.1%} of the picture lies beyond the masks as they were moved; {made}.",
        _NOTHING,
    )
    DARKER_THAN_DARK = (
        "darker_than_dark",
        DOUBT,
        "{share:.0%} of the pixels read clearly less than no light: too much of a dark level was subtracted, or there "
        "is much noise.",
        _SCALE,
    )
    BRIGHTER_THAN_WHITE = (
        "brighter_than_white",
        DOUBT,
        "{share:.0%} of the pixels read more light than a white scene would send through their masks: the masks are "
        "not those of this exposure, the unit is not the full scale of one view, or there is much noise.",
        f"{_MASKS} {_SCALE}",
    )
    VERY_DARK = (
        "very_dark",
        DOUBT,
        "The brightest readings are {share:.2g} of those of a white scene: the scene is very dark, or the unit is not "
        "the full scale of one view.",
        f"Use more light. {_SCALE}",
    )
    UNEVEN_VIEWS = (
        "uneven_views",
        DOUBT,
        "Views seem to be {least:.2f} to {most:.2f} times as bright as the middle one: the weights are not those of "
        "this exposure, the lamp flickers, or the scene changes.",
        "Use a lamp on direct current, and weights that are the shares of the exposure that each mask was shown.",
    )
    WEIGHTS_CORRECTED = (
        "weights_corrected",
        REMARK,
        "Views were {least:.2f} to {most:.2f} times as bright as their weights say; the weights were corrected by what "
        "the measurement shows.",
        "To keep the weights of the file: `gs2ci reconstruct --trust-weights`.",
    )
    LIGHT_AS_SEEN = (
        "light_as_seen",
        REMARK,
        "Views were {least:.2f} to {most:.2f} times as bright as one another, by the lamp or by the scene, which the "
        "measurement cannot tell: the scene is even, and the views are handed over as bright as they were seen.",
        "To have them as under even light: `gs2ci reconstruct --light even`.",
    )

    # The masks.
    SINGLE_VIEW = (
        "single_view",
        DOUBT,
        "There is one view only: neither a camera path nor depth can be found.",
        "Show several masks in one exposure while the camera moves.",
    )
    UNLIT_VIEWS = (
        "unlit_views",
        DOUBT,
        "No light reached views {views}: only the others tell of them.",
        "Check those masks and their weights.",
    )
    FAINT_VIEWS = (
        "faint_views",
        DOUBT,
        "Hardly any light reached views {views}: little can be known of them.",
        "Check those masks and their weights.",
    )
    SAME_MASKS = (
        "same_masks",
        DOUBT,
        "All masks are the same: the measurement is one long exposure, and does not tell views apart.",
        "Show a different mask for each view, and see that the file's masks were read: `gs2ci import --mask-key`.",
    )
    UNOPENED_PIXELS = (
        "unopened_pixels",
        DOUBT,
        "No mask opens {count} of {of} pixels: there the views follow from their surroundings.",
        "Draw masks that open every pixel at least once.",
    )
    MOSTLY_UNOPENED = (
        "mostly_unopened",
        DOUBT,
        "That is most of the picture.",
        "Show more masks, or masks with more open elements.",
    )

    # The sensor.
    DEAD_LINES = (
        "dead_lines",
        REMARK,
        "{count} of {of} {lines} read one value throughout, the first of them number {first}: left out as dead.",
        _NOTHING,
    )
    STUCK_BORDER_LINES = (
        "stuck_border_lines",
        DOUBT,
        "{count} of {of} {lines} read one value throughout, the first of them number {first}: they lie along the "
        "border, and were left as they are.",
        "Close the masks there if the sensor is dead.",
    )
    HOT_PIXELS = (
        "hot_pixels",
        REMARK,
        "{pixels} more light than a white scene would send through the masks, while those around do not: left out.",
        _NOTHING,
    )

    # The focal length.
    FOCAL_ASSUMED = (
        "focal_assumed",
        DOUBT,
        "The focal length is not known and {why}; a horizontal field of view of {view_angle_deg:.0f}° is assumed. "
        "Depths are then true only up to a stretch.",
        _FOCAL,
    )
    FOCAL_ESTIMATED = (
        "focal_estimated",
        REMARK,
        "The focal length was estimated from the tracks: {focal_px:.0f} px within about {spread:.0%}, a horizontal "
        "field of view of {view_angle_deg:.0f}°.",
        _FOCAL,
    )
    FOCAL_OF_CAMERA_FILE = (
        "focal_of_camera_file",
        DOUBT,
        "The camera file's focal length is {of_file_px:.0f} px, the shot's {of_shot_px:.0f} px; the file's is taken, "
        "as its poses belong to it.",
        "Check which of the two belongs to this measurement.",
    )
    FOCAL_OF_SHOT = (
        "focal_of_shot",
        DOUBT,
        "The camera file's focal length is {of_file_px:.0f} px, the shot's {of_shot_px:.0f} px; the shot's is taken, "
        "as its distortion belongs to it.",
        "Check which of the two belongs to this measurement.",
    )
    FOCAL_CHANGED = (
        "focal_changed",
        DOUBT,
        "The adjustment changed the focal length by a factor of {factor:.1f}.",
        _FOCAL,
    )

    # Points to follow, and what they say of the motion.
    FEW_TRACKS = (
        "few_tracks",
        DOUBT,
        "Only {tracks} points could be tracked; {needed} are needed.",
        _MORE_POINTS,
    )
    CLUSTERED_TRACKS = (
        "clustered_tracks",
        DOUBT,
        "The tracked points cover {share:.0%} of the image; {needed:.0%} is needed.",
        "Use a scene with texture over more of the frame.",
    )
    FEW_VIEWS_TRACKED = (
        "few_views_tracked",
        DOUBT,
        "Only {views} of {of} views see {tracks} tracked points or more; half of the views must.",
        _MORE_POINTS,
    )
    UNREGISTERED_VIEWS = (
        "unregistered_views",
        DOUBT,
        "{share:.0%} of the views see enough tracks; {needed:.0%} is needed.",
        _MORE_POINTS,
    )
    CAMERA_STOOD_STILL = (
        "camera_stood_still",
        DOUBT,
        "The views differ by {displacement_px:.2f} px: the camera did not move, so depth cannot be found.",
        _MOVE,
    )
    CAMERA_ONLY_TURNED = (
        "camera_only_turned",
        DOUBT,
        "Rotations alone explain the tracks to {rotations_px:.2f} px: the camera only turned, so depth cannot be "
        "found.",
        _MOVE,
    )
    PARALLAX_MAY_DROWN = (
        "parallax_may_drown",
        DOUBT,
        "Rotations alone explain the tracks to {rotations_px:.2f} px, a motion would to {motion_px:.2f} px: the camera "
        "only turned, or its parallax drowns in such errors, so depth cannot be found.",
        _MOVE,
    )
    FEW_TRACKS_EXPLAINED = (
        "few_tracks_explained",
        DOUBT,
        "The motion explains only {tracks} of {of} tracks.",
        _RIGID,
    )
    TRACKS_BADLY_EXPLAINED = (
        "tracks_badly_explained",
        DOUBT,
        "The motion explains the tracks to {rms_px:.2f} px only; {needed_px} is needed.",
        _RIGID,
    )
    POINTS_BEHIND_CAMERA = (
        "points_behind_camera",
        DOUBT,
        "The motion puts {share:.0%} of the points behind a camera.",
        _RIGID,
    )
    TURN_TOO_LARGE = (
        "turn_too_large",
        DOUBT,
        "The motion turns a view by {turn_deg:.0f}°; tracks can be followed over {most_deg:.0f}° at most.",
        "Turn the camera less in one exposure; a repeating texture is followed wrongly.",
    )
    PATH_UNCERTAIN = (
        "path_uncertain",
        DOUBT,
        "The first camera path is uncertain: halves of the tracked points give paths so different that an error of "
        "{share:.0%} of its extent is to be expected.",
        _RELY_NOT,
    )
    POSES_INTERPOLATED = (
        "poses_interpolated",
        DOUBT,
        "Too few points could be tracked in views {views}; their poses lie on the path of the others.",
        _MORE_POINTS,
    )
    DEPTH_STARTS_AS_PLANE = (
        "depth_starts_as_plane",
        DOUBT,
        "The scene starts as a plane, and the fit has to find its depth alone: near and far may be exchanged.",
        "Do not rely on depth.",
    )

    ATTEMPTS_RANKED = (
        "attempts_ranked",
        REMARK,
        "Several beginnings were fitted; they leave of the held-out pixels: {ranking} (rms, full scale 1). The first "
        "was taken, by a margin of {margin:.1%}.",
        _NOTHING,
    )

    # Things that move.
    SCENE_MOVES = (
        "scene_moves",
        REMARK,
        "Things in the scene move by themselves: {share:.0%} of the pixels, by {median_px:.1f} px over the exposure in "
        "the median and {most_px:.1f} px at most. A still scene leaves more of the measurement unexplained.",
        "See `motion.png` for what moves and how fast; `gs2ci reconstruct --motion off` fits a still scene.",
    )
    MOTION_NOT_TAKEN = (
        "motion_not_taken",
        REMARK,
        "Some of what the still scene leaves looks like motion ({explained:.1%} of its power), but scenes that move "
        "explain the held-out pixels no better. The still scene was taken.",
        _NOTHING,
    )

    VIEWS_POLISHED = (
        "views_polished",
        REMARK,
        "What the scene leaves looks like motion, and a decode by similar patches went on from the refined views: they "
        "leave {after:.4f} of the held-out pixels instead of {before:.4f} (rms, full scale 1).",
        "`gs2ci reconstruct --motion off` leaves that out.",
    )

    # Near and far.
    DEPTH_ORDER_OPEN = (
        "depth_order_open",
        DOUBT,
        "Near and far may be exchanged: with so little motion, or in so narrow a field of view, the scene inside out "
        "explains the measurement about as well (the difference is {errors:.1f} standard errors; 2 are needed).",
        "Do not rely on depth or on the direction of the path. Move the camera further, or let a stage report its "
        "poses: their sign decides (`gs2ci reconstruct --geometry stage`).",
    )
    DEPTH_IN_NOISE = (
        "depth_in_noise",
        DOUBT,
        "Near and far may be exchanged: the views leave {share:.0%} of what an even grey leaves of the held-out "
        "pixels, and with so much noise a fit finds depth that is not there.",
        "Do not rely on depth. Use more light, or let a stage report its poses.",
    )
    DEPTH_ORDER_UNTRIED = (
        "depth_order_untried",
        DOUBT,
        "Near and far may be exchanged: the tracked points alone cannot tell, and the pixels were not asked.",
        "Reconstruct without a budget, and not as a draft: short fits of both orders then decide.",
    )
    DEPTH_ORDER_TURNED = (
        "depth_order_turned",
        REMARK,
        "The tracked points gave a scene inside out; fits of both orders prefer near and far exchanged, by "
        "{errors:.1f} standard errors, and that was taken.",
        _NOTHING,
    )
    POSES_SIGN_CONTRADICTED = (
        "poses_sign_contradicted",
        DOUBT,
        "The picture contradicts the sign of the poses of the {source}: with the path reversed, and near and far "
        "exchanged, short fits leave {less:.0%} less of the measurement. The reverse was taken.",
        "Check the direction of travel in [stage.mount] or the file's convention, or measure the axes with "
        "`gs2ci calibrate stage`.",
    )

    # Which source the first path came from.
    SOURCE_CHOSEN = (
        "source_chosen",
        REMARK,
        "Geometry from {source}. Left unexplained: {answers}.",
        "To have it from elsewhere, name the source: `gs2ci reconstruct --geometry`.",
    )
    SOURCE_FAILED = (
        "source_failed",
        FAILURE,
        "Not from {source}: {problem}. The tracks were taken instead.",
        _POSES,
    )
    STAGE_NOT_TAKEN = (
        "stage_not_taken",
        DOUBT,
        "The stage's poses were not taken.",
        "Check [stage.mount] and the unit, or measure the axes with `gs2ci calibrate stage`.",
    )
    STAGE_SIGN_CONTRADICTED = (
        "stage_sign_contradicted",
        DOUBT,
        "The stage's poses were not taken: with them the scene would lie behind the camera, and with the direction of "
        "travel reversed the picture bears them out.",
        "Turn the sign of the axis in [stage.mount], or measure the axes with `gs2ci calibrate stage`; poses must be "
        "world-to-camera with OpenCV axes.",
    )
    STAGE_MOTION_UNSEEN = (
        "stage_motion_unseen",
        DOUBT,
        "The stage reports a motion of which the views show nothing.",
        "See that it carries the camera.",
    )
    POSES_NOT_BORNE_OUT = (
        "poses_not_borne_out",
        DOUBT,
        "The given poses were not taken: reversed, or at rest, the camera explains the measurement about as well.",
        _POSES,
    )
    POSES_NOT_TAKEN = (
        "poses_not_taken",
        DOUBT,
        "The poses of the {source} were not taken: the views do not bear out a path, and the fit began without.",
        _POSES,
    )
    POSES_UNCHECKED = (
        "poses_unchecked",
        REMARK,
        "Poses and the range of depths are the file's; the tracks could not check them.",
        _NOTHING,
    )
    POSES_MOVED = (
        "poses_moved",
        REMARK,
        "The fit moved the poses of the {source} by {share:.1%} of the path and {rotation_deg:.3f}°.",
        _NOTHING,
    )
    DEPTH_RANGE_FOUND = (
        "depth_range_found",
        REMARK,
        "The range of depths is the one by which the given poses explain the measurement best.",
        _NOTHING,
    )
    WIDE_MOTION = (
        "wide_motion",
        REMARK,
        "The camera path was found from {points} points that were matched between all pairs of views.",
        _NOTHING,
    )
    UNIFORM_MOTION = (
        "uniform_motion",
        DOUBT,
        "The camera path is the uniform motion that explains the measurement best; no tracked points bear it out. It "
        "leaves {share:.0%} of what a camera at rest leaves.",
        _RELY_NOT,
    )
    UNIFORM_TURN = (
        "uniform_turn",
        DOUBT,
        "Turning explains the measurement, and a motion hardly more of it, so depth cannot be found.",
        _MOVE,
    )
    PATH_FOUND_AGAIN = (
        "path_found_again",
        REMARK,
        "The first camera path was doubtful; it was found again in the views of a first fit, and fitted again.",
        _NOTHING,
    )

    PROXIES_CHOSEN = (
        "proxies_chosen",
        REMARK,
        "The geometry was sought in proxy views by {method}: {multiplicity:.4g} views share a pixel.",
        _NOTHING,
    )

    # VGGT, where the user has added it.
    TRACKS_FOR_VGGT = (
        "tracks_for_vggt",
        REMARK,
        "VGGT has not been added: this project's tracks and plane sweep stand in for it.",
        "Add the model: `gs2ci models add vggt FILE`.",
    )
    VGGT_POSES_TAKEN = (
        "vggt_poses_taken",
        REMARK,
        "VGGT's poses were taken {step}, views {order}{before}.",
        _NOTHING,
    )
    VGGT_DEPTH_TAKEN = (
        "vggt_depth_taken",
        DOUBT,
        "VGGT's own cameras and depth were taken; {checked}{before}.",
        _RELY_NOT,
    )
    VGGT_FOCAL_TAKEN = (
        "vggt_focal_taken",
        REMARK,
        "The focal length is VGGT's: {focal_px:.0f} px.",
        _FOCAL,
    )
    VGGT_FOCAL_DIFFERS = (
        "vggt_focal_differs",
        DOUBT,
        "VGGT takes the focal length for {focal_px:.0f} px where {known_px:.0f} px is known.",
        "Check the camera matrix of the shot: `gs2ci import --intrinsics`.",
    )
    VGGT_FOCAL_REFUSED = (
        "vggt_focal_refused",
        REMARK,
        "VGGT's focal length, {focal_px:.0f} px, was refused: {why}.",
        _FOCAL,
    )

    # The fits.
    ROLLED_BACK_NOT_FINITE = (
        "rolled_back_not_finite",
        REMARK,
        "Iteration {iteration} was not finite: back to iteration {best} with half the step.",
        "If it happens often, look for broken pixels: `gs2ci import --bad-pixels median`.",
    )
    ROLLED_BACK_EXPLODED = (
        "rolled_back_exploded",
        REMARK,
        "Iteration {iteration} exploded, the loss rose from {least_loss:.3g} to {loss:.3g}: back to iteration {best} "
        "with half the step.",
        "If it happens often, look for broken pixels: `gs2ci import --bad-pixels median`.",
    )
    OF_ANOTHER_FIT = (
        "of_another_fit",
        REMARK,
        "Another fit: {sentence}",
        _NOTHING,
    )
    FITS_MISSING = (
        "fits_missing",
        DOUBT,
        "{fits} of {of} fits came to an end: the others left the finite numbers, or found no time.",
        "Give it more time (`gs2ci reconstruct --budget`), or look for broken pixels (`gs2ci import --bad-pixels "
        "median`).",
    )
    MEAN_REFUSED = (
        "mean_refused",
        REMARK,
        "Held-out pixels prefer one of the fits to their mean: the views are that one's.",
        _NOTHING,
    )
    FINE_HELPED = (
        "fine_helped",
        REMARK,
        "The fine stage ({with_prior}) lowered the held-out residual from {before:.5f} to {after:.5f}.",
        _NOTHING,
    )
    FINE_UNJUDGED = (
        "fine_unjudged",
        DOUBT,
        "The fine stage ({with_prior}) was not judged.",
        "Compare with a run without `--fine`.",
    )
    STAND_IN = (
        "stand_in",
        REMARK,
        "{absent} has not been added: {instead} stands in for it.",
        "Add the model: `gs2ci models add`.",
    )
    FINE_UNCHANGED = (
        "fine_unchanged",
        REMARK,
        "The fine stage changed nothing: {why}.",
        "Another prior may help: `gs2ci reconstruct --prior`.",
    )

    FINE_LEFT_OUT = (
        "fine_left_out",
        FAILURE,
        "The fine stage was left out: it takes views from beside the cameras, and needs things at rest for that.",
        "`gs2ci reconstruct --motion off --fine` refines a still scene.",
    )

    # The result.
    VIEWS_COMBINED = (
        "views_combined",
        REMARK,
        "The views are {refined:.0%} the refined ones, {scene:.0%} the scene's and {decode:.0%} the decode's: by the "
        "held-out pixels, together they err least.",
        _NOTHING,
    )
    UNJUDGED = (
        "unjudged",
        DOUBT,
        "No pixel was held out, so nothing tells whether the scene is better than the decode; both are kept.",
        "Use less light or more open masks, so that enough pixels are lit and unsaturated.",
    )
    LITTLE_EXPLAINED = (
        "little_explained",
        DOUBT,
        "On the held-out pixels, the views leave {share} of what an even grey leaves unexplained: there is much noise "
        "or little to see, or the masks are not those of this exposure.",
        _MASKS,
    )
    VIEWS_ERR = (
        "views_err",
        DOUBT,
        "The views are expected to err by about {share:.1%} of full scale (rms of all pixels: a PSNR of {psnr_db:.0f} "
        "dB), by what they leave of the held-out pixels; by less where most of that is noise.",
        "Use more light, masks that leave fewer pixels dark, or fewer masks in one exposure.",
    )
    DECODE_KEPT = (
        "decode_kept",
        DOUBT,
        "The scene does not explain the measurement better than the decode does: views.npy and the figures are the "
        "decode's, what the scene shows is in scene_views.npy.",
        _RIGID,
    )

    # Comparison with a truth, or with another measurement.
    TRUE_PATH_STRAIGHT = (
        "true_path_straight",
        REMARK,
        "The camera path is too straight for its positions to tell the rotation about it to a degree; rotation_deg "
        "takes that roll from the cameras' own orientations.",
        _NOTHING,
    )
    TRUE_PATH_REVERSED = (
        "true_path_reversed",
        FAILURE,
        "The scene is inside out: the camera path runs backwards against the true one, and near and far are exchanged. "
        "The views may be right all the same; path, depth and scene are not.",
        "Give the camera poses (`gs2ci reconstruct --geometry stage` or `file:PATH`), or move the camera further.",
    )
    TRUE_PATH_STILL = (
        "true_path_still",
        REMARK,
        "A camera that stands still leaves the alignment without scale and rotation; rotation_deg takes the rotation "
        "from the cameras' own orientations, and ate is at the estimate's own scale.",
        _NOTHING,
    )
    OTHER_SCALE = (
        "other_scale",
        DOUBT,
        "The shot's readings are {ratio:.3g} times those that were reconstructed, as if it was imported with another "
        "scale: views and residual are off by as much.",
        "Import it with the same scale: `gs2ci import --scale`.",
    )
    OTHER_MASKS = (
        "other_masks",
        DOUBT,
        "The shot's masks are not those of the reconstruction: the residual is that of the shot's.",
        "Import it with the same masks: `gs2ci import --masks`.",
    )
    PROXIES_BY_ENERGY = (
        "proxies_by_energy",
        DOUBT,
        "The proxies are energy-normalised although many views share a pixel: {problem}.",
        "Show masks that differ more from each other.",
    )


@dataclass(frozen=True)
class Finding:
    """Something found in one run. Make it with `finding`, which writes its sentence.

    Args:
        code: What kind.
        sentence: What is said.
        figures: The numbers in it, by name.
    """

    code: Code
    sentence: str
    figures: Mapping[str, Figure] = field(default_factory=dict)

    @property
    def advice(self) -> str:
        """Get the sentence, with the remedy behind it where there is something to be doubted."""
        return self.sentence if self.code.weight is REMARK else f"{self.sentence} {self.code.remedy}"


def finding(code: Code, /, **figures: Figure) -> Finding:
    """Find something, and write its sentence.

    Args:
        code: What.
        figures: All that its sentence names.

    Raises:
        KeyError: A figure is missing.
    """
    return Finding(code, code.sentence.format(**figures), figures)
