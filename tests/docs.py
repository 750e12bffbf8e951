"""`python -m tests.docs`: write the pages of the docs that are made from the code.

    docs/report.schema.json   JSON schema of report.json, from `gs2ci.evaluate.report`
    docs/batch-row.schema.json  JSON schema of a row of many exposures, from `gs2ci.batch.rows`
    docs/shot.schema.json     JSON schema of a shot file's description, from `gs2ci.core.storage`
    docs/bundle.schema.json   JSON schema of a calibration bundle's description, from `gs2ci_calibration.bundle`
    docs/findings.md          everything that a reconstruction may find worth telling, from `gs2ci.core.findings`
    docs/idealisations.md     what the twins leave out, from `gs2ci_sims.idealisations`

`tests/test_made_docs.py` holds the pages to the code.
"""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from gs2ci.batch.rows import Row
from gs2ci.core.findings import Code, Weight
from gs2ci.core.storage import layout
from gs2ci.evaluate.report import Report
from gs2ci_calibration import bundle
from gs2ci_sims.idealisations import IDEALISATIONS, Idealisation

DOCS = Path(__file__).parents[1] / "docs"

_HEAD = """\
# Findings

Everything that a reconstruction may report: why a fit ended, what is doubtful, what was done about it.
`report.json` contains each with its code, its sentence and its figures, under `notes` and, for the end of the fit,
`stopped`; programs should read the code. Names in braces are figures. Made from `gs2ci/core/sentences/` by
`python -m tests.docs`.

A *remark* is worth knowing and needs no action. A *doubt* means that part of the result is less reliable than usual.
A *failure* means that something that was requested could not be done, and the result lacks it.
"""

_IDEALISATIONS_HEAD = """\
# What the twins leave out

A simulated bench runs the same drivers as a real one, against twins of the devices. This table lists what the twins do
better than real devices, and the setting that switches it. `devices = "typical"` in `[world]`, the default, sets all
figures of the last column that the rig file does not set itself; `devices = "ideal"` sets none. The twins' protocols,
errors and faults are not ideal in any case ([faults](faults.md)).
Made from `sims/gs2ci_sims/idealisations.py` by `python -m tests.docs`.
"""


def report_schema() -> str:
    """Return the JSON schema of `report.json`."""
    return json.dumps(Report.model_json_schema(by_alias=True, mode="serialization"), indent=1) + "\n"


def findings_page() -> str:
    """Return the page that lists all findings."""
    parts = [_HEAD]
    for weight, title in ((Weight.FAILURE, "Failures"), (Weight.DOUBT, "Doubts"), (Weight.REMARK, "Remarks")):
        rows = [f"| `{code}` | {code.sentence} | {code.remedy} |" for code in Code if code.weight is weight]
        parts.append(
            "\n".join((f"\n## {title}\n", "| code | what is said | what to do |", "|---|---|---|", *rows)) + "\n"
        )
    return "".join(parts)


def idealisations_page() -> str:
    """Return the page that lists what the twins of a simulated bench do better than devices."""

    def switch(one: Idealisation) -> tuple[str, str]:
        if not one.key:
            return "not to be switched", ""
        table, _, name = one.key.rpartition(".")
        where = f"`[world.{table}.{name}]`" if table else f"`{name}` in `[world]`"
        figure = "" if one.typical is None else f"`{as_toml(one.typical)}`"
        return where, figure

    rows = [
        f"| {one.device} | {one.twin} | {one.real} | {one.source} | {switch(one)[0]} | {switch(one)[1]} |"
        for one in IDEALISATIONS
    ]
    head = ("| device | its twin | real ones | source | switched by | typical |", "|---|---|---|---|---|---|")
    return "\n".join((_IDEALISATIONS_HEAD, *head, *rows)) + "\n"


def as_toml(value: object) -> str:
    """Write a figure as it stands in a rig file."""
    if isinstance(value, dict):
        return ", ".join(f"{key} = {as_toml(part)}" for key, part in value.items()) or "its defaults"
    return json.dumps(value)


def row_schema() -> str:
    """Return the JSON schema of a row of `gs2ci reconstruct --all`."""
    return json.dumps(Row.model_json_schema(mode="serialization"), indent=1) + "\n"


def shot_schema() -> str:
    """Return the JSON schema of the description of a shot file: attributes, and kind and shape of every dataset."""
    plain, optional = ("meas_valid", "masks/calib", "calib/weights", "complete", "provenance"), dict(layout.CALIBRATION)
    frames = {f"frames/{name}": (kind, 1) for name, kind in layout.FRAME_COLUMNS.items()}
    known = {
        "meas": {"dtype": {"enum": ["<u2", "<f4"]}, "shape": _axes(3, 4)},
        "meas_valid": {"dtype": {"const": "|u1"}, "shape": _axes(1)},
        "saturated": {"dtype": {"const": "|u1"}, "shape": _axes(3)},
        "masks/calib": {"dtype": {"enum": ["<f4", "|u1"]}, "shape": _axes(3)},
        "calib/weights": {"dtype": {"const": "<f8"}, "shape": _axes(1)},
        "camera/intrinsics": {"dtype": {"const": "<f8"}, "shape": {"const": [3, 3]}},
        "camera/distortion": {"dtype": {"const": "<f8"}, "shape": {"const": [5]}},
        "telemetry/world_to_camera": {"dtype": {"const": "<f8"}, "shape": _axes(4)},
        "truth/views": {"dtype": {"enum": ["<f4", "|u1"]}, "shape": _axes(5)},
        "truth/world_to_camera": {"dtype": {"const": "<f8"}, "shape": _axes(4)},
        "truth/depth": {"dtype": {"const": "<f4"}, "shape": _axes(4)},
        "complete": {"dtype": {"const": "|u1"}, "shape": {"const": []}},
    }
    for name, (kind, axes) in {**optional, **frames}.items():
        known[name] = {"dtype": {"const": np.dtype(kind).str}, "shape": _axes(axes)}
    return _description("A shot file", layout.SCHEMA, known, ("meas", *plain), {})


def bundle_schema() -> str:
    """Return the JSON schema of the description of a calibration bundle."""
    number = {"properties": {"dtype": {"enum": ["<f4", "<f8"]}}}
    patterns = {
        "^/sections/[^/]+/record$": {},
        "^/sections/[^/]+/estimates/[^/]+/(value|standard_error)$": number,
        "^/sections/[^/]+/arrays/[^/]+$": {},
    }
    known = {"complete": {"dtype": {"const": "|u1"}, "shape": {"const": []}}, "provenance": {}}
    return _description("A calibration bundle", bundle.SCHEMA, known, ("complete", "provenance"), patterns, closed=True)


def _axes(*counts: int) -> dict[str, Any]:
    return {"minItems": min(counts), "maxItems": max(counts)}


def _description(
    title: str,
    schema: str,
    known: dict[str, Any],
    required: Sequence[str],
    patterns: dict[str, Any],
    *,
    closed: bool = False,
) -> str:
    dataset = {
        "type": "object",
        "properties": {
            "dtype": {"type": "string"},
            "shape": {"type": "array", "items": {"type": "integer", "minimum": 0}},
        },
        "required": ["dtype", "shape"],
    }
    datasets: dict[str, Any] = {
        "type": "object",
        "properties": {
            f"/{name}": {"allOf": [{"$ref": "#/$defs/dataset"}, {"properties": of}]} for name, of in known.items()
        },
        "required": [f"/{name}" for name in required],
        "additionalProperties": False if closed else {"$ref": "#/$defs/dataset"},
    }
    if patterns:
        datasets["patternProperties"] = {
            key: {"allOf": [{"$ref": "#/$defs/dataset"}, of]} for key, of in patterns.items()
        }
    whole = {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": f"{title}, described: its attributes, and dtype and shape of each dataset (docs/formats.md)",
        "type": "object",
        "properties": {
            "attributes": {"type": "object", "properties": {"schema": {"const": schema}}, "required": ["schema"]},
            "datasets": datasets,
        },
        "required": ["attributes", "datasets"],
        "$defs": {"dataset": dataset},
    }
    return json.dumps(whole, indent=1) + "\n"


PAGES = {
    "batch-row.schema.json": row_schema,
    "shot.schema.json": shot_schema,
    "bundle.schema.json": bundle_schema,
    "report.schema.json": report_schema,
    "findings.md": findings_page,
    "idealisations.md": idealisations_page,
}


if __name__ == "__main__":
    for name, text in PAGES.items():
        (DOCS / name).write_text(text(), encoding="utf-8")
        print(DOCS / name)
