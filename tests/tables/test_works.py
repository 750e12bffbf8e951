"""What cells measure, on a scene of the library."""

from dataclasses import asdict

import pytest

from gs2ci.tables.cases import Case
from gs2ci.tables.catalogue import INITIALISATION
from gs2ci.tables.works import initialise_case


@pytest.mark.parametrize("variant", ["default", "eni"])
def test_a_first_geometry_is_measured_against_the_truth(variant):
    row = initialise_case(asdict(Case("boxes", scene="boxes", size=(48, 64), views=4)), variant, 0)
    assert {measure.key for measure in INITIALISATION} <= row.keys()
    assert row["unexplained"] > 0
    assert row["full"] in (0.0, 1.0)
    assert row["rpe_r_deg"] >= 0
    assert (row["depth_rank"] is None) == (row["verdict"] != "full")
    assert row["failure"] == "" or row["depth_rank"] is None or "exchanged" in row["failure"]
    assert row["source"] in ("tracks", "uniform")
    assert (row["path_error_expected"] is None) == (row["source"] == "uniform" or row["verdict"] != "full")
