"""The notebooks of docs/tutorials do what they say, each in a kernel and a folder of its own."""

import re
from pathlib import Path

import nbformat
import numba
import pytest
from nbclient import NotebookClient

import gs2ci
from tests.nightly import but
from tests.patience import HANG_S

TUTORIALS = sorted((Path(__file__).parents[1] / "docs" / "tutorials").glob("*.ipynb"))


def test_there_are_five():
    assert [path.name.split("-")[0] for path in TUTORIALS] == list("12345")


@pytest.mark.parametrize("path", TUTORIALS, ids=lambda path: path.stem)
def test_they_carry_no_output_of_somebody_elses_machine(path):
    notebook = nbformat.read(path, as_version=4)
    nbformat.validate(notebook)
    assert all(not cell.get("outputs") and cell.get("execution_count") is None for cell in notebook.cells)


def test_they_and_the_pages_call_what_there_is():
    docs = TUTORIALS[0].parents[1]
    pages = [*TUTORIALS, *docs.rglob("*.md"), docs.parent / "README.md"]
    called = {name for page in pages for name in re.findall(r"\bgs2ci\.(\w+)\(", page.read_text(encoding="utf-8"))}
    assert "reconstruct" in called
    assert not [name for name in called if not hasattr(gs2ci, name)]


# The kernel's library for its sockets opens them in ways that warn on some platforms; what counts is the cells.
@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("path", but(1, TUTORIALS), ids=lambda path: path.stem)
def test_they_run(path, tmp_path, monkeypatch):
    monkeypatch.setenv("GS2CI_HOME", str(tmp_path / "home"))
    monkeypatch.setenv("IPYTHONDIR", str(tmp_path / "ipython"))
    # A kernel would take all processors, beside the suite's other processes: threads that wait for each other then.
    for library in ("NUMBA", "OMP"):
        monkeypatch.setenv(f"{library}_NUM_THREADS", str(numba.get_num_threads()))
    notebook = nbformat.read(path, as_version=4)
    NotebookClient(notebook, timeout=HANG_S, resources={"metadata": {"path": str(tmp_path)}}).execute()
    outputs = [output for cell in notebook.cells for output in cell.get("outputs", [])]
    kinds = {kind for output in outputs for kind in output.get("data", {})}
    assert kinds & {"text/html", "text/markdown"}
    assert not [output for output in outputs if output.output_type == "error" or output.get("name") == "stderr"]
    if path.stem == "1-first-scene":
        # What a newcomer sees first is a path and a depth, not why there is none.
        printed = "".join(output["text"] for output in outputs if output.output_type == "stream")
        assert float(re.search(r"rank correlation of depths .* (-?[\d.]+) \(", printed)[1]) > 0.6
        assert float(re.search(r"path error ([\d.]+)%", printed)[1]) < 10
