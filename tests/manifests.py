"""The manifest beside a finished file, held against the file. Nothing here is a test."""

import hashlib
import json
from pathlib import Path


def assert_manifest_fits(path: Path) -> None:
    """Assert that a file is byte for byte the one that its manifest describes."""
    content = path.read_bytes()
    assert json.loads(path.with_suffix(".json").read_text()) == {
        "schema": "gs2ci.manifest/1",
        "file": path.name,
        "bytes": len(content),
        "sha256": hashlib.sha256(content).hexdigest(),
    }
