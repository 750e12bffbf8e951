"""Every effect's bound, over a randomised family of scenes, rigs and masks: it holds, and it is not idle.

The same over hundreds of draws each: `python -m tests.benchmarks effect_bounds`.
"""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gs2ci_sims.effects.flicker import IlluminationDrift, IlluminationFlicker, LcosFlicker
from gs2ci_sims.effects.motion_blur import MotionBlur
from gs2ci_sims.effects.photons import Dust
from gs2ci_sims.effects.stage import StageBacklash, StageVibration
from gs2ci_sims.effects.timing import RollingShutter, TriggerTiming
from gs2ci_sims.effects.transitions import LcosResponse
from gs2ci_sims.exact import ExactRenderer
from tests.sims.adversaries import FAMILIES
from tests.sims.families import FAMILY, SAMPLED, Case, ratios, reversing

pytestmark = pytest.mark.slow

IDLE_BELOW = 0.1
EXAMPLES = 8
RASTERISED = 1.5
SCENES = 12


@pytest.fixture(scope="module")
def family():
    """Cases by seed and masks, each made once."""
    made = {}

    def get(seed, masks):
        if (seed, masks) not in made:
            made[seed, masks] = Case(seed, masks)
        return made[seed, masks]

    return get


def holds(found, by_rays):
    """Tell whether a change keeps within its bound: as the rasteriser draws it, or else as rays do.

    Bounds are those of the scene's light. The rasteriser draws it with steps and cut-offs of its own
    (`python -m tests.benchmarks exact_renderer`), which carry a change over its bound by up to 1.4 times (motion blur).
    """
    return max(found) <= 1.0 or (max(found) <= RASTERISED and max(by_rays()) <= 1.0)


def over_the_family(family, effects, ratios_of, examples=EXAMPLES):
    """Draw cases of the family and figures of an effect; the bound must hold for all and be near for one."""
    reached = []

    @settings(max_examples=examples, deadline=None, derandomize=True, database=None)
    @given(seed=st.integers(0, SCENES - 1), masks=st.sampled_from(sorted(FAMILIES)), data=st.data())
    def each(seed, masks, data):
        case = family(seed, masks)
        effect = data.draw(effects(case))
        found = ratios_of(case, effect)
        assert holds(found, lambda: ratios_of(case, effect, renderer=ExactRenderer()))
        reached.append(found[0])

    each()
    assert max(reached) >= IDLE_BELOW


@pytest.mark.parametrize("kind", FAMILY, ids=lambda kind: kind.name)
def test_leaving_an_effect_out_changes_no_more_than_its_bound_and_somewhere_a_tenth_of_it(family, kind):
    def ratios_of(case, effect, **options):
        return ratios(case, effect, path=reversing(case) if kind is StageBacklash else None, **options)

    # Few of the drawn vibrations come near their bound.
    over_the_family(family, FAMILY[kind], ratios_of, examples=(2 if kind is StageVibration else 1) * EXAMPLES)


def unsampled(case, effect, **options):
    return ratios(case, effect, sampled=(), **options)


def test_one_view_per_mask_is_off_from_motion_blur_by_no_more_than_its_bound(family):
    over_the_family(family, lambda case: st.just(MotionBlur(15)), unsampled)


@settings(max_examples=24, deadline=None, derandomize=True, database=None)
@given(seed=st.integers(0, SCENES - 1), masks=st.sampled_from(sorted(FAMILIES)), data=st.data())
def test_bounds_hold_in_the_company_of_other_effects(family, seed, masks, data):
    case = family(seed, masks)
    kinds = data.draw(
        st.lists(st.sampled_from(sorted(FAMILY, key=lambda kind: kind.name)), min_size=3, max_size=3, unique=True)
    )
    effect, *company = [data.draw(FAMILY[kind](case)) for kind in kinds]

    def ratios_of(**options):
        return ratios(case, effect, company=tuple(company), sampled=SAMPLED, **options)

    assert holds(ratios_of(), lambda: ratios_of(renderer=ExactRenderer()))


# Effects whose change cancels over an interval, or lies at one end of it, beside others that act just there.
COINCIDING = {
    "a lamp that drifts and rows that open late": (
        39,
        "all open",
        IlluminationDrift(-1.0),
        (Dust(1.0, 1.0, 1.0), RollingShutter(4e-5)),
    ),
    "a lamp that drifts and an early trigger": (28, "grey", IlluminationDrift(1.6), (TriggerTiming(-3.2e-3, 4e-4),)),
    "a lamp that drifts before slow crystals": (2, "hadamard", IlluminationDrift(1.0), (LcosResponse(3.5e-3),)),
    "a panel and a lamp that beat": (
        38,
        "one-hot",
        LcosFlicker(7.3e-3, 3535.323970469432),
        (IlluminationFlicker(1.0, 1732.2126841860563),),
    ),
}


@pytest.mark.parametrize("case", COINCIDING)
def test_a_bound_holds_where_what_two_effects_do_coincides_within_a_mask(case):
    seed, masks, effect, company = COINCIDING[case]
    seen = Case(seed, masks)
    assert holds(
        ratios(seen, effect, company=company), lambda: ratios(seen, effect, company=company, renderer=ExactRenderer())
    )
