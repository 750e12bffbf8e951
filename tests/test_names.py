"""One name, one thing: no public class of any package shares its name with another."""

import re
from collections import defaultdict
from pathlib import Path

import gs2ci
import gs2ci_calibration
import gs2ci_drivers
import gs2ci_sims


def test_no_public_class_shares_its_name_with_another():
    defined = defaultdict(list)
    for package in (gs2ci, gs2ci_drivers, gs2ci_calibration, gs2ci_sims):
        for path in sorted(Path(package.__file__).parent.rglob("*.py")):
            for name in re.findall(r"^class ([A-Za-z]\w*)", path.read_text(encoding="utf-8"), re.MULTILINE):
                defined[name].append(path.name)
    twice = {name: files for name, files in defined.items() if len(files) > 1}
    assert not twice
