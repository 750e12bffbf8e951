"""`python -m tests.docs`: write the pages of the docs that are made from the code.

    docs/report.schema.json   JSON schema of report.json, from `gs2ci.evaluate.report`
    docs/batch-row.schema.json  JSON schema of a row of many exposures, from `gs2ci.batch.rows`
    docs/shot.schema.json     JSON schema of a shot file's description, from `gs2ci.core.storage`
    docs/bundle.schema.json   JSON schema of a calibration bundle's description, from `gs2ci_calibration.bundle`
    docs/findings.md          everything that a reconstruction may find worth telling, from `gs2ci.core.findings`
    docs/devices.md           what real devices do otherwise than one would guess, from `gs2ci_drivers.manners`
    docs/idealisations.md     what the twins leave out, from `gs2ci_sims.idealisations`
    docs/rig-file.md          every key of a bench's rig file, from `gs2ci.rig.config`
    docs/mechanisms.md        mechanisms and constants of presets, from `gs2ci.reconstruct`; its figures stay

`tests/test_made_docs.py` holds the pages to the code.
"""

import json
from collections.abc import Iterator, Sequence
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np

from gs2ci.batch.rows import Row
from gs2ci.core.findings import Code, Weight
from gs2ci.core.storage import layout
from gs2ci.evaluate.report import Report
from gs2ci.reconstruct.mechanisms import MECHANISMS
from gs2ci.reconstruct.presets.named import PRESETS, preset
from gs2ci.rig.config import RigTable
from gs2ci_calibration import bundle
from gs2ci_drivers.manners import kinds, manners_of
from gs2ci_drivers.plugin import BUILT_IN
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
Made from `sims/gs2ci_sims/idealisations.toml` by `python -m tests.docs`.
"""

_DEVICES_HEAD = """\
# What real devices do

What devices do where one would guess otherwise, by family and firmware, with the source and the test that plays it.
`gs2ci doctor` prints the rows of the devices that it finds.

Not supported: stages of PI (GCS 2) and Newport, Zaber's binary protocol, printers' firmware; panels of Hamamatsu,
Meadowlark and Holoeye over USB or PCIe. As a second display such a panel is `kind = "video"`: levels for its wavelength
are `dark_level`, `bright_level` or `grey_table`, and the three colours of a picture are equal, so that a panel which
reads more than 8 bits, or several binary pictures, from the colours of one frame shows others than were sent.
[Plug-ins](plugins.md) add devices.

Made from `drivers/gs2ci_drivers/manners/*.toml` by `python -m tests.docs`.
"""

_MECHANISMS_HEAD = """\
# Mechanisms

What the default is made of beyond decode, geometry and fit, the constants of the presets, and what each mechanism gave
when it was last left out. `python -m tests.tables ablation --mechanisms` leaves them out one at a time
([tables](tables.md)); the rule by which they stay is in
[CONTRIBUTING](../CONTRIBUTING.md).
Lists and constants are made from `gs2ci/reconstruct` by `python -m tests.docs`.
"""
_FIGURES_HEAD = "\n## What leaving them out costs\n"

_RIG_HEAD = """\
# The rig file

Every key of the file (TOML) that describes a bench. [docs/rigs](rigs) has files to start from, [the bench](bench.md)
says how the devices work together. An unknown key is refused, with the nearest known one. A key without a default may
be left out. Devices by other packages have tables of their own: [plug-ins](plugins.md).
Made from `gs2ci/rig/config.py` and the drivers' options by `python -m tests.docs`.
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


def devices_page() -> str:
    """Return the page that lists what real devices do otherwise than one would guess."""
    parts = [_DEVICES_HEAD]
    for kind in kinds():
        rows = [
            " | ".join((one.applies, one.guess, f"**{one.fact}**", one.source, f"`{one.test.split('::')[1]}`"))
            .replace("\n", " ")
            .replace("|", "\\|")
            .replace(" \\| ", " | ")
            for one in manners_of(kind)
        ]
        head = ("| which | one would guess | it does | source | played by |", "|---|---|---|---|---|")
        title = f'kind = "{kind}"' if any(kind in group for group in BUILT_IN.values()) else kind
        parts.append("\n".join((f"\n## {title}\n", *head, *(f"| {row} |" for row in rows))) + "\n")
    return "".join(parts)


def as_toml(value: object) -> str:
    """Write a figure as it stands in a rig file."""
    if isinstance(value, dict):
        return ", ".join(f"{key} = {as_toml(part)}" for key, part in value.items()) or "its defaults"
    return json.dumps(value)


def rig_page() -> str:
    """Return the page that lists every key of a bench's rig file."""
    schema = RigTable.model_json_schema()
    sections = dict.fromkeys(_tables("", schema, schema["$defs"], {}))  # [stage.mount] is one for all kinds of stages
    return "\n".join((_RIG_HEAD, *sections))


def _tables(name: str, node: dict[str, Any], defs: dict[str, Any], defaults: dict[str, Any]) -> Iterator[str]:
    """Yield a section for a table of a JSON schema, and one for each table in it; one for each kind of a device."""
    node = _resolved(node, defs)
    for kind in (*node.get("oneOf", ()), *node.get("anyOf", ())):
        yield from _tables(name, kind, defs, {})
    of_any_name = node.get("additionalProperties")
    if isinstance(of_any_name, dict) and "$ref" in of_any_name:
        yield from _tables(f"{name}.NAME", of_any_name, defs, {})
    keys = {key: _resolved(part, defs) for key, part in node.get("properties", {}).items()}
    inner = {
        key: list(_tables(f"{name}.{key}".strip("."), part, defs, part.get("default") or {}))
        for key, part in keys.items()
    }
    rows = [
        f"| `{key}` | {_values(part, defs)} | {_default(defaults.get(key, part.get('default')))} "
        f"| {part.get('description', '')} |".replace("\n", " ")
        for key, part in keys.items()
        if key != "kind" and not inner[key]
    ]
    if rows:
        kind = keys.get("kind", {}).get("const")
        title = (f"[{name}]" if name else "At the top") + (f', kind = "{kind}"' if kind else "")
        head = ("| key | values | default | what it is |", "|---|---|---|---|")
        yield "\n".join((f"## {title}\n", *head, *rows)) + "\n"
    for sections in inner.values():
        yield from sections


def _resolved(node: dict[str, Any], defs: dict[str, Any]) -> dict[str, Any]:
    return {**defs[node["$ref"].rpartition("/")[2]], **node} if "$ref" in node else node


# Limits beyond which only slips of the keyboard lie: a day, a million.
_FAR = {86_400, 1_000_000}
_BOUNDS = {"minimum": "from", "exclusiveMinimum": "above", "maximum": "to", "exclusiveMaximum": "below"}
_KINDS = {
    "integer": "whole number",
    "number": "number",
    "boolean": "true or false",
    "string": "text",
    "object": "a table",
}


def _values(node: dict[str, Any], defs: dict[str, Any]) -> str:
    """Say in a few words which values a key may have."""
    kinds = [kind for kind in node.get("anyOf", ()) if kind.get("type") != "null"]
    if kinds:
        return " or ".join(_values(_resolved(kind, defs), defs) for kind in kinds)
    if "enum" in node:
        return ", ".join(f"`{as_toml(value)}`" for value in node["enum"])
    if node["type"] == "array":
        parts = node.get("prefixItems", ())
        each = _values(_resolved(parts[0] if parts else node["items"], defs), defs)
        return f"a list of {len(parts)}: {each}" if parts else f"a list: {each}"
    bounds = [f"{word} {node[key]:g}" for key, word in _BOUNDS.items() if key in node and abs(node[key]) not in _FAR]
    return " ".join((_KINDS[node["type"]], *bounds))


def _default(value: object) -> str:
    return "" if value is None else f"`{as_toml(value)}`"


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
        "masks/order": {"dtype": {"const": "<u2"}, "shape": _axes(2)},
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


def mechanisms_page() -> str:
    """Write the mechanisms and the presets' constants; what follows them is a text of its own, and stays."""
    kept = (DOCS / "mechanisms.md").read_text(encoding="utf-8").partition(_FIGURES_HEAD)[2]
    listed = [f"| {one.name} | {one.what} | [{one.decision}](decisions/{one.decision}.md) |" for one in MECHANISMS]
    constants = {name: dict(_constants(preset(name), "")) for name in PRESETS}
    names = dict.fromkeys(key for found in constants.values() for key, value in found.items() if value is not None)
    rows = [
        f"| `{key}` | " + " | ".join(_said(found.get(key, "–")) for found in constants.values()) + " |" for key in names
    ]
    parts = [
        _MECHANISMS_HEAD,
        "| mechanism | what it does | let in by |\n|---|---|---|",
        *listed,
        "\n## Constants of the presets\n",
        "Every setting that is a number, a word or a switch; – where a preset leaves the part out.\n",
        "| setting | " + " | ".join(constants) + " |\n|---|" + "---|" * len(constants),
        *rows,
    ]
    return "\n".join(parts) + "\n" + _FIGURES_HEAD + kept


def _constants(value: Any, name: str) -> Iterator[tuple[str, Any]]:
    """Yield the plain settings below a name."""
    if is_dataclass(value):
        for one in fields(value):
            yield from _constants(getattr(value, one.name), f"{name}.{one.name}".strip("."))
    elif isinstance(value, tuple) and any(is_dataclass(one) for one in value):
        for number, one in enumerate(value):
            yield from _constants(one, f"{name}[{number}]")
    else:
        yield name, value


def _said(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:.4g}"
    if isinstance(value, tuple):
        return ", ".join(_said(one) for one in value) or "none"
    return "–" if value is None else str(value)


PAGES = {
    "batch-row.schema.json": row_schema,
    "shot.schema.json": shot_schema,
    "bundle.schema.json": bundle_schema,
    "report.schema.json": report_schema,
    "findings.md": findings_page,
    "devices.md": devices_page,
    "idealisations.md": idealisations_page,
    "rig-file.md": rig_page,
    "mechanisms.md": mechanisms_page,
}


if __name__ == "__main__":
    for name, text in PAGES.items():
        (DOCS / name).write_text(text(), encoding="utf-8")
        print(DOCS / name)
