from dataclasses import dataclass, field, replace
from typing import Annotated, Literal

import numpy as np
import pytest
from pydantic import AfterValidator, Field, PositiveInt

from gs2ci.core.bounds import Bounded, BoundedRecord, odd
from gs2ci.core.config import Positive
from gs2ci.core.errors import InputError


@dataclass(frozen=True)
class Inner(Bounded):
    window_px: Annotated[int, Field(ge=3, le=255), AfterValidator(odd)] = 7


@dataclass(frozen=True)
class Outer(Bounded):
    count: PositiveInt = 1
    share: Annotated[float, Field(gt=0, le=1)] = 1.0
    levels: Annotated[tuple[Positive, ...], Field(min_length=1)] = (0.5,)
    mode: Literal["auto", "off"] = "auto"
    rate: Positive | None = None
    free: object = None
    inner: Inner = field(default_factory=Inner)
    more: tuple[Inner, ...] = ()


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"count": 0}, "count = 0 in Outer; allowed: greater than 0"),
        ({"count": 1.5}, "count = 1.5 in Outer; allowed: a valid integer"),
        ({"share": 0.0}, "share = 0.0 in Outer; allowed: greater than 0"),
        ({"share": np.nan}, "share = nan in Outer; allowed: "),
        ({"levels": ()}, r"levels = \(\) in Outer; allowed: "),
        ({"levels": (1.0, np.inf)}, r"levels = \(1.0, inf\) in Outer; allowed: a finite number"),
        ({"mode": "on"}, "mode = 'on' in Outer; allowed: 'auto' or 'off'"),
        ({"rate": -1.0}, "rate = -1.0 in Outer; allowed: greater than 0"),
        ({"inner": Inner(1)}, "window_px = 1 in Inner; allowed: greater than or equal to 3"),
        ({"inner": Inner(8)}, "window_px = 8 in Inner; allowed: an odd number"),
        ({"more": (Inner(), Inner(257))}, "window_px = 257 in Inner; allowed: less than or equal to 255"),
    ],
)
def test_a_value_out_of_the_bounds_beside_its_field_is_refused_by_name(wrong, said):
    with pytest.raises(InputError, match=said):
        replace(Outer(), **wrong).check()


def test_what_is_within_its_bounds_is_returned_as_it_is():
    settings = Outer(count=np.int64(3), share=np.float32(0.5), rate=2, free="anything", more=(Inner(3), Inner(255)))
    assert settings.check() is settings
    assert isinstance(settings.count, np.int64)


@dataclass(frozen=True)
class Made(BoundedRecord):
    share: Annotated[float, Field(ge=0, le=1)]


def test_a_record_out_of_its_bounds_is_not_made():
    assert Made(1.0).share == 1.0
    with pytest.raises(InputError, match=r"share = 1\.5 in Made; allowed: less than or equal to 1"):
        Made(1.5)
    with pytest.raises(InputError, match="share = -1 in Made"):
        replace(Made(0.0), share=-1)
