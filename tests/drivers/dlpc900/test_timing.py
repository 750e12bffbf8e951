"""What each mirror device can do, against the reference's tables."""

import pytest

from gs2ci_drivers.dlpc900.timing import (
    MODELS,
    DmdType,
    max_patterns,
    min_exposure_us,
    patterns_per_image,
    upload_reports,
    upload_s,
)

MIN_EXPOSURE_US = """
1  105  105  100   62
2  304  304  343  184
3  394  380  438  269
4  823  733  768  458
5 1215 1215 1299  682
6 1487 1487 1488  807
7 1998 1998 2000 1083
8 4046 4046 4046 2263
"""


@pytest.mark.parametrize("row", MIN_EXPOSURE_US.strip().splitlines())
def test_minimum_times_are_the_tables(row: str) -> None:
    bits, *times = map(int, row.split())
    models = [MODELS[kind] for kind in (DmdType.DLP6500, DmdType.DLP9000, DmdType.DLP670S, DmdType.DLP500YX)]
    assert [min_exposure_us(model, bits) for model in models] == times


BLOCK_US = """
DLP6500 24 45 45 45 48 54 60 66 72 78 84 90 96 101 105
DLP9000 24 42 42 42 45 51 56 61 67 72 77 83 88 93 99 105
DLP670S 27 27 27 33 38 38 49 55 61 66 72 77 83 89 94 100
DLP500YX 30 30 30 30 34 38 42 46 50 54 58 62
"""


@pytest.mark.parametrize("row", BLOCK_US.strip().splitlines())
def test_minimum_times_of_fewer_blocks_are_the_tables(row: str) -> None:
    name, *times = row.split()
    model = MODELS[DmdType[name]]
    assert [min_exposure_us(model, 1, blocks=i + 1) for i in range(model.blocks)] == [int(time) for time in times]
    assert model.height % model.blocks == 0
    assert int(times[-1]) == min_exposure_us(model, 1)


def test_capacity_is_memory_entries_or_images_whichever_is_least() -> None:
    assert max_patterns(MODELS[DmdType.DLP6500], 1) == 400
    assert max_patterns(MODELS[DmdType.DLP9000], 1) == 400
    assert max_patterns(MODELS[DmdType.DLP6500], 8) == 50
    assert max_patterns(MODELS[DmdType.DLP500YX], 8) == 54
    assert max_patterns(MODELS[DmdType.DLP5500], 1) == 432
    assert [patterns_per_image(bits) for bits in range(1, 9)] == [24, 12, 8, 6, 4, 4, 3, 3]


def test_upload_costs_a_millisecond_a_report() -> None:
    assert upload_reports(504) == 1 + 8
    assert upload_reports(505) == 1 + 8 + 1
    assert upload_reports(504 + 56) == 1 + 8 + 1
    assert upload_reports(504 + 57) == 1 + 8 + 2
    # The reference's figure for random masks of single pixels: 6.2 MB, about 99 s.
    assert upload_s(6_226_252) == pytest.approx(99, abs=0.5)
