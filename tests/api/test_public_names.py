"""What `gs2ci` promises to people who write Python: names, types, docstrings and examples that run."""

import doctest
import inspect
import pydoc
import re
import subprocess
import sys
from pathlib import Path

import pytest

import gs2ci
import gs2ci.reconstruct.pipeline  # binds the package's name, which must not hide the function
from gs2ci.api import preparing
from gs2ci.cli import COMMANDS

NAMES = {
    "DeviceError", "Gaussians", "GeometryError", "Gs2ciError", "InputError", "NumericsError", "OpenRig", "Progress",
    "ResourceError", "Run", "Shot", "Silent", "StorageError", "Truth", "__version__", "add_model", "compile_kernels",
    "decode", "demo_rig", "design", "evaluate", "explain", "export", "export_model", "find_devices", "import_file",
    "list_models", "list_plugins", "load", "measure", "mesh", "open_rig", "open_run", "ophyd_bench",
    "plan", "reconstruct", "reconstruct_many", "recover", "save", "sweep", "tradeoff", "update_bundle",
}  # fmt: skip
CALLED = sorted(NAMES - {"__version__"})
HEAVY = ("numpy", "torch", "numba", "scipy", "cv2", "h5py", "rich", "pydantic", "matplotlib", "tyro")


def target(name):
    """The function or class that a public name stands for."""
    found = getattr(gs2ci, name)
    return found._function if inspect.ismodule(found) else found


def test_the_public_names_are_these_and_no_others():
    assert set(gs2ci.__all__) == NAMES
    assert set(dir(gs2ci)) >= NAMES
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        gs2ci.nothing  # noqa: B018


def test_type_checkers_are_told_the_same_names():
    stub = (Path(gs2ci.__file__).parent / "__init__.pyi").read_text()
    told = set(re.findall(r"^from (\S+) import (\w+) as \2$", stub, re.MULTILINE))
    assert told == {(target(name).__module__, name) for name in CALLED}
    assert set(re.findall(r'^    "(\w+)",$', stub, re.MULTILINE)) == NAMES


def test_help_describes_the_function_also_of_a_package_that_is_called():
    for name in CALLED:
        said = pydoc.render_doc(getattr(gs2ci, name), renderer=pydoc.plaintext)
        first = inspect.getdoc(target(name)).splitlines()[0]
        assert first in said, name
        assert "Args:" not in target(name).__doc__ or "Args:" in said, name


def test_every_name_is_documented_and_typed_and_has_an_example():
    assert [name for name in CALLED if ">>> " not in (inspect.getdoc(target(name)) or "")] == []
    for found in filter(inspect.isfunction, map(target, CALLED)):
        signature = inspect.signature(found)
        assert signature.return_annotation is not inspect.Signature.empty
        for parameter in signature.parameters.values():
            assert parameter.annotation is not inspect.Parameter.empty
            assert re.search(rf"^ +{parameter.name}: ", found.__doc__, re.MULTILINE), parameter.name


@pytest.mark.parametrize("name", CALLED)
def test_its_examples_do_what_they_say(name, examples, monkeypatch):
    # It compiles for half a minute; tests/commands/test_compile.py has what it compiles by.
    monkeypatch.setattr(preparing, "modules_with_kernels", lambda: ("gs2ci.reconstruct.fit.kernels.gaussian_kernels",))
    finder = doctest.DocTestFinder(recurse=inspect.isclass(target(name)))
    flags = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE
    runner = doctest.DocTestRunner(optionflags=flags, verbose=False)
    for test in finder.find(target(name), name, globs={"gs2ci": gs2ci}):
        runner.run(test)
    results = runner.summarize(verbose=False)
    assert results.attempted > 0
    assert results.failed == 0


def loaded_by(code):
    """Which of the heavy libraries a fresh process has loaded after some code."""
    asked = f"{code}\nimport sys; print(*[name for name in {HEAVY} if name in sys.modules])"
    done = subprocess.run([sys.executable, "-c", asked], capture_output=True, text=True, check=True)
    return done.stdout.splitlines()[-1].split()


def test_importing_the_package_loads_no_library():
    assert loaded_by("import gs2ci; dir(gs2ci); gs2ci.reconstruct") == []


def test_the_overview_of_commands_loads_no_library():
    code = "import sys; sys.argv = ['gs2ci', '--help']; from gs2ci.cli import main; main(); print()"
    assert loaded_by(code) == []


def test_packages_of_the_functions_names_are_called_and_stay_packages():
    assert "shot" in inspect.signature(gs2ci.reconstruct).parameters
    assert "run" in inspect.signature(gs2ci.evaluate).parameters
    assert gs2ci.reconstruct.pipeline is sys.modules["gs2ci.reconstruct.pipeline"]


def test_python_can_do_whatever_a_command_does():
    """By the table of docs/python.md, which names every command and whose names all exist."""
    page = (Path(__file__).resolve().parents[2] / "docs" / "python.md").read_text(encoding="utf-8")
    rows = dict(re.findall(r"^\| `gs2ci ([a-z]+)` \| (.*) \|$", page, re.MULTILINE))
    assert list(rows) == list(COMMANDS)
    owners = {"gs2ci": gs2ci, "run": gs2ci.Run, "rig": gs2ci.OpenRig}
    for command, told in rows.items():
        ways = re.findall(r"`(gs2ci|run|rig)\.(\w+)`", told)
        assert bool(ways) is (command != "completion")
        for owner, name in ways:
            assert hasattr(owners[owner], name), f"{owner}.{name}"
    told = set(
        re.findall(
            r"`(\w+)`", page[page.index("## What there is") : page.index("The Python equivalent of each command")]
        )
    )
    assert told == set(CALLED)
