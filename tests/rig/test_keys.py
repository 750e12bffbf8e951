"""Every key that a remedy, a page of the docs or an example names exists in the model that reads it."""

import ast
import re
import tomllib
from functools import cache
from pathlib import Path
from typing import Any, get_args, get_origin

import pytest
from pydantic import BaseModel

from gs2ci.rig.config import RigTable

ROOT = Path(__file__).parents[2]
SOURCES = sorted(
    path
    for folder in ("drivers", "calibration", "gs2ci/rig", "gs2ci/commands", "gs2ci/core")
    for path in (ROOT / folder).rglob("*.py")
)
PAGES = [*sorted((ROOT / "docs").rglob("*.md")), ROOT / "README.md"]
NOT_KEYS = {"exposure", "trigger_mode", "lsusb", "unprocessed_raw", "transform_matrix", "fl_x", "camera_angle_x"}
"""Named in remedies and no keys: a control of the camera, a kernel module's parameter, a program, keys of a
transforms.json."""


def models_in(annotation: Any) -> list[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [model for part in get_args(annotation) for model in models_in(part)]


def tables(model: type[BaseModel] = RigTable, prefix: str = "") -> dict[str, set[str]]:
    """Return the keys of each table by its dotted name, all kinds of a device together."""
    found: dict[str, set[str]] = {prefix: set(model.model_fields)}
    for name, field in model.model_fields.items():
        if get_origin(field.annotation) is dict:  # its keys are the user's
            found.setdefault(f"{prefix}.{name}".strip("."), set())
        for inner in models_in(field.annotation):
            for table, keys in tables(inner, f"{prefix}.{name}".strip(".")).items():
                found[table] = found.get(table, set()) | keys
    return found


# Tables whose keys are the user's own.
FREE = {"metadata"}
TABLES = tables()
KEYS = set().union(*TABLES.values())
NAMED = re.compile(r"\[([a-z_]+(?:\.[a-z_0-9]+)?)\]")
QUOTED = re.compile(r"`([a-z][a-z0-9_]*)(?: = [^`]*)?`")
SAID = re.compile(r"\b(?:set|raise|lower|change|or|and) ([a-z]+_[a-z0-9_]+)\b")
PLACED = re.compile(r"((?:`?[a-z][a-z0-9_]*`?(?:, or |, | and | or )?)+) in \[([a-z_.]+)\]")
ASSIGNED = re.compile(r"\b([a-z][a-z0-9_]+) = (?=['\"{\d]|true|false)")


def text_of(node: ast.expr) -> str:
    """Return a string's text, with what is put into it at run time left out."""
    if isinstance(node, ast.Constant) and isinstance(node.value, str):
        return node.value
    if isinstance(node, ast.JoinedStr):
        return "".join(part.value if isinstance(part, ast.Constant) else "0" for part in node.values)
    if isinstance(node, ast.BinOp):
        return text_of(node.left) + text_of(node.right)
    if isinstance(node, ast.IfExp):
        return f"{text_of(node.body)} | {text_of(node.orelse)}"
    return ""


@cache
def remedies() -> list[tuple[str, str]]:
    """Return every remedy in the sources, and every other text that names a table of a rig file."""
    found = []
    for path in SOURCES:
        source = path.read_text(encoding="utf-8")
        if not re.search(r"\b(?:remedy|allowed|set)\b", source):
            continue
        name = path.relative_to(ROOT)
        for node in ast.walk(ast.parse(source)):
            if not isinstance(node, ast.keyword | ast.Constant | ast.JoinedStr):
                continue
            where = f"{name}:{node.lineno}"
            if isinstance(node, ast.keyword) and node.arg in ("remedy", "allowed"):
                found.append((where, text_of(node.value)))
            elif isinstance(node, ast.Constant | ast.JoinedStr):
                text = text_of(node)
                if re.search(r"\bset\b", text) and set(NAMED.findall(text)) & TABLES.keys() and "\n" not in text:
                    found.append((where, text))
    return [(where, text) for where, text in found if text]


def unknown_keys(text: str) -> set[str]:
    """Return what a remedy calls a key and is none: of the table that follows it, or of any."""
    said = {*QUOTED.findall(text), *SAID.findall(text), *ASSIGNED.findall(text)} - NOT_KEYS
    # To look for keys before a table where none is named takes very long: their pattern fits in many ways.
    placed = {
        key
        for keys, table in (PLACED.findall(text) if " in [" in text else ())
        if table in TABLES
        for key in re.findall(r"[a-z]+_[a-z0-9_]+", keys)
        if key not in TABLES[table]
    }
    return (said - KEYS) | placed


def test_there_are_remedies_to_be_read():
    assert len(remedies()) > 200
    assert sum(bool(QUOTED.search(text)) for _, text in remedies()) > 30


def test_every_key_that_a_remedy_names_exists():
    wrong = {where: sorted(unknown_keys(text)) for where, text in remedies() if unknown_keys(text)}
    assert wrong == {}


@pytest.mark.parametrize("text", ["set `fourcc` in [sensor]", "raise late in [modulator] or `late`", "set late_ms"])
def test_a_key_that_does_not_exist_is_found(text):
    assert unknown_keys(text)


def test_every_table_that_a_remedy_names_exists():
    wrong = {
        where: table
        for where, text in remedies()
        for table in NAMED.findall(text)
        if table.split(".")[0] in RigTable.model_fields and table not in TABLES
    }
    assert wrong == {}


def test_every_key_that_a_page_names_with_its_table_exists():
    texts = {page.name: " ".join(page.read_text(encoding="utf-8").split()) for page in PAGES}
    wrong = [
        (name, key, table)
        for name, text in texts.items()
        for keys, table in re.findall(r"((?:`[a-z][a-z0-9_]*`(?:, | and | or )?)+) in `?\[([a-z_.]+)\]", text)
        for key in QUOTED.findall(keys)
        if table in TABLES and key not in TABLES[table]
    ]
    assert wrong == []


def test_every_example_of_a_rig_file_in_a_page_is_one():
    for page in PAGES:
        for block in re.findall(r"```toml\n(.*?)```", page.read_text(encoding="utf-8"), re.DOTALL):
            for table, keys in tomllib.loads(block).items():
                if table in TABLES and table not in FREE and isinstance(keys, dict):
                    assert set(keys) <= TABLES[table], (page.name, table)
