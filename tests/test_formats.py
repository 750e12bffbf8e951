"""Files that are written fit the schemas that the documentation gives."""

import json
from dataclasses import replace
from pathlib import Path

import h5py
import jsonschema
import numpy as np
import pytest

from gs2ci.batch.rows import Row, RowProblem
from gs2ci.core.storage import write_shots
from gs2ci_calibration.bundle import Bundle, Provenance, write_bundle
from gs2ci_calibration.estimates import Estimate, Section
from tests.test_code_blocks import FENCED

DOCS = Path(__file__).resolve().parents[1] / "docs"


def schema(name):
    return json.loads((DOCS / f"{name}.schema.json").read_text())


def described(path):
    """Describe a file as the page on formats does."""
    code = next(text for _, text in FENCED.findall((DOCS / "formats.md").read_text()) if "def described" in text)
    names = {}
    exec(code.partition('with h5py.File("shot.h5")')[0], names)
    with h5py.File(path) as file:
        return names["described"](file)


def test_a_shot_file_fits_its_schema_with_all_that_it_may_hold(tmp_path, random_shot):
    whole = replace(
        random_shot,
        intrinsics=np.array([[20.0, 0, 10], [0, 20, 8], [0, 0, 1]]),
        distortion=np.zeros(5),
        telemetry_world_to_camera=random_shot.truth.world_to_camera,
        saturated=np.zeros((16, 20), bool),
    )
    for number, shot in enumerate((random_shot, whole)):
        path = write_shots(tmp_path / f"{number}.h5", [shot])
        jsonschema.validate(described(path), schema("shot"))


@pytest.mark.parametrize(
    "spoil",
    [
        lambda found: found["attributes"].update(schema="gs2ci.capture/9"),
        lambda found: found["datasets"].pop("/meas"),
        lambda found: found["datasets"]["/calib/weights"].update(dtype="<f4"),
        lambda found: found["datasets"]["/masks/calib"]["shape"].append(3),
    ],
)
def test_what_is_no_shot_file_does_not_fit(tmp_path, random_shot, spoil):
    found = described(write_shots(tmp_path / "shot.h5", [random_shot]))
    spoil(found)
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate(found, schema("shot"))


def test_a_bundle_fits_its_schema_and_a_stray_dataset_does_not(tmp_path):
    section = Section(
        "dark-flat",
        {
            "offset_dn": Estimate(np.ones((2, 3), np.float32), np.float32(0.1), "DN"),
            "rate": Estimate(1.5, 0.25, "DN/s"),
        },
        arrays={"hot": np.eye(2, 3, dtype=np.uint8)},
        facts={"frames": 32},
        measured_utc="2030-01-02T03:04:05+00:00",
    )
    bench = Provenance("name = 'x'\n", {"sensor": ("cam", "7", "v1")}, True, 31.5)
    found = described(write_bundle(tmp_path / "bench.cal.h5", Bundle(bench, {"dark-flat": section})))
    jsonschema.validate(found, schema("bundle"))
    found["datasets"]["/notes"] = {"dtype": "|u1", "shape": [2]}
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate(found, schema("bundle"))


@pytest.mark.parametrize("state", ["done", "failed", "lost"])
def test_a_row_of_many_exposures_fits_its_schema(state):
    problem = None if state == "done" else RowProblem(kind="GeometryError", problem="no path")
    row = Row(name="a-000", state=state, file="a.h5", index=0, key="k", problem=problem)
    jsonschema.validate(json.loads(row.model_dump_json()), schema("batch-row"))
