"""Files and modules that module headers and docstrings refer to exist."""

import re
from pathlib import Path

ROOT = Path(__file__).parent.parent
FOLDERS = ("gs2ci", "drivers", "calibration", "sims")
FILES = [path for folder in FOLDERS for path in sorted((ROOT / folder).rglob("*.py"))]
# Groups of entry points, which look like modules.
NO_MODULES = {f"gs2ci.{group}" for group in ("density_rules", "modulators", "sensors", "stages")}


def module_of(path):
    parts = path.relative_to(ROOT).with_suffix("").parts
    parts = parts if parts[0] == "gs2ci" else parts[1:]
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def test_what_docstrings_refer_to_exists():
    texts = {path: path.read_text(encoding="utf-8") for path in FILES}
    words = {module_of(path): set(re.findall(r"\w+", text)) for path, text in texts.items()}
    missing = []
    for path, text in texts.items():
        docstrings = re.findall(r'"""(.*?)"""', text, re.DOTALL)
        for name in re.findall(r"`([\w./]+)`", "\n".join(docstrings)):
            if re.fullmatch(r"gs2ci(_\w+)?(\.\w+)+", name):
                known = name in NO_MODULES or is_known(name, words)
            elif name.endswith(".py"):
                places = [path.parent, *path.parents, ROOT / "gs2ci" / "reconstruct"]
                known = any((place / name).exists() for place in places)
            else:
                continue
            missing += [] if known else [f"{path.relative_to(ROOT)}: {name}"]
    assert missing == ["gs2ci/reconstruct/learned/onnx_video_decoder.py: tools/test.py"]  # a file of cacti's


def is_known(name, words):
    """Tell whether a dotted name is a module, or a name that stands in the module before it."""
    parts = name.split(".")
    module = next((".".join(parts[:k]) for k in range(len(parts), 0, -1) if ".".join(parts[:k]) in words), None)
    rest = parts[len(module.split(".")) :] if module else parts
    return module is not None and (not rest or rest[0] in words[module])
