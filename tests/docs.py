"""`python -m tests.docs`: write the pages of the docs that are made from the code.

    docs/report.schema.json   JSON schema of report.json, from `gs2ci.evaluate.report`
    docs/findings.md          everything that a reconstruction may find worth telling, from `gs2ci.core.findings`

`tests/test_made_docs.py` holds the pages to the code.
"""

import json
from pathlib import Path

from gs2ci.core.findings import Code, Weight
from gs2ci.evaluate.report import Report

DOCS = Path(__file__).parents[1] / "docs"

_HEAD = """\
# Findings

Everything that a reconstruction may find worth telling: why a fit ended, what to doubt, what it did about it.
`report.json` holds each with its code, its sentence and its figures, under `notes` and, for the end of the fit,
`stopped`; programs read the code. Names in braces are figures. Made from `gs2ci/core/findings.py` by
`python -m tests.docs`.

A *remark* is worth knowing and asks for nothing. After a *doubt*, part of the result is not to be relied on as far as
usual. A *failure* means that something that was asked for could not be done, and the result is without it.
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


PAGES = {"report.schema.json": report_schema, "findings.md": findings_page}


if __name__ == "__main__":
    for name, text in PAGES.items():
        (DOCS / name).write_text(text(), encoding="utf-8")
        print(DOCS / name)
