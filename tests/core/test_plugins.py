"""Packages that add to gs2ci, sound and broken, as they lie on the path once they are installed."""

import sys

import pytest

from gs2ci.core.errors import InputError
from gs2ci.core.plugins import GROUPS, PluginError, allowed, brought, called, installed, load, names

RULES = "gs2ci.density_rules"


@pytest.fixture
def package(tmp_path, monkeypatch):
    """Install a package of one module by the metadata that pip would write."""

    def install(name, entries, source="RULE = 7\n"):
        folder = tmp_path / name
        information = folder / f"{name}-1.5.dist-info"
        information.mkdir(parents=True)
        (information / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.5\n")
        text = "".join(f"[{group}]\n" + "".join(f"{a} = {b}\n" for a, b in of.items()) for group, of in entries.items())
        (information / "entry_points.txt").write_text(text)
        (folder / f"{name}.py").write_text(source)
        monkeypatch.syspath_prepend(folder)
        monkeypatch.delitem(sys.modules, name, raising=False)
        return folder

    return install


def test_a_plug_in_is_found_by_its_name_and_says_where_it_comes_from(package):
    package("mine", {RULES: {"seven": "mine:RULE"}})
    assert load(RULES, "seven") == 7
    assert "seven" in names(RULES)
    assert allowed(RULES, ("osgr",)) == "osgr, seven"
    (plugin,) = [one for one in installed() if one.name == "seven"]
    assert (plugin.origin, plugin.target, plugin.problem) == ("mine 1.5", "mine:RULE", "")


def test_a_name_that_nobody_brings_is_none():
    assert load(RULES, "nobodys") is None


@pytest.mark.parametrize(
    ("source", "said"),
    [
        ("import nothing_of_that_name\n", "ModuleNotFoundError: No module named 'nothing_of_that_name'"),
        ("OTHER = 1\n", "AttributeError"),
        ("raise RuntimeError('half installed')\n", "RuntimeError: half installed"),
    ],
)
def test_one_that_is_broken_is_named_with_its_package_and_stops_no_other(package, source, said):
    package("broken", {RULES: {"bad": "broken:RULE"}}, source)
    package("sound", {RULES: {"good": "sound:RULE"}})
    with pytest.raises(PluginError, match=r"the plug-in 'bad' of broken 1\.5 cannot be used"):
        load(RULES, "bad")
    told = {one.name: one.problem for one in installed()}
    assert said in told["bad"]
    assert told["good"] == ""
    assert load(RULES, "good") == 7


def test_two_of_one_name_are_both_left_out(package):
    package("first", {RULES: {"same": "first:RULE"}})
    package("second", {RULES: {"same": "second:RULE"}})
    with pytest.raises(PluginError, match="both bring one of that name"):
        load(RULES, "same")


def test_a_package_that_is_on_the_path_twice_is_one(package, monkeypatch, tmp_path):
    folder = package("mine", {RULES: {"seven": "mine:RULE"}})
    monkeypatch.syspath_prepend(str(folder) + "/.")
    assert load(RULES, "seven") == 7


def test_our_own_names_cannot_be_taken(package):
    package("bold", {RULES: {"osgr": "bold:RULE"}})
    (plugin,) = [one for one in installed({RULES: ("osgr",)}) if one.package == "bold"]
    assert "itself" in plugin.problem


def test_every_group_says_where_its_names_are_typed():
    assert all(group.startswith("gs2ci.") and used for group, used in GROUPS.items())


def test_the_command_lists_them_and_names_the_broken(package, gs2ci, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "200")
    package("mine", {RULES: {"seven": "mine:RULE"}, "gs2ci.scenes": {"moon": "mine:MOON"}})
    assert gs2ci("plugins") == 0
    out = capsys.readouterr().out
    assert "mine 1.5" in out
    assert "gs2ci reconstruct --density" in out
    assert "moon of mine 1.5 is left out: AttributeError" in out


def test_the_list_keeps_brackets_and_long_places_in_a_narrow_terminal(package, gs2ci, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    monkeypatch.setattr("gs2ci.api.plugins.installed", lambda _: installed())
    package("mylab", {"gs2ci.effects": {"haze": "mylab:RULE"}, RULES: {"long": "mylab:A_RULE_WITH_A_LONG_NAME"}})
    assert gs2ci("plugins") == 0
    out = capsys.readouterr().out
    assert "[effects.NAME] of a rig file" in out
    assert "…" not in out


@pytest.mark.parametrize("error", [ValueError("256 px"), OSError("no licence")], ids=["value", "os"])
def test_what_a_plug_in_raises_names_it_and_its_place(error):
    def brought(shot):
        raise error

    with pytest.raises(PluginError, match=rf"'mine' failed: {type(error).__name__}: .* of test_plugins.py\)") as caught:
        called("mine", brought, 7)
    assert caught.value.__cause__ is error
    assert called("mine", len, "abc") == 3


def test_what_a_plug_in_returns_fails_in_its_name_as_well(package):
    source = "def make(seed):\n    def prior(x):\n        return x / seed\n    prior.name = 'mine'\n    return prior\n"
    package("mine", {"gs2ci.priors": {"mine": "mine:make"}}, source)
    assert brought("gs2ci.priors", "nobody") is None
    prior = brought("gs2ci.priors", "mine", 0)
    assert prior.name == "mine"
    assert brought("gs2ci.priors", "mine", 2)(3) == 1.5
    with pytest.raises(PluginError, match=r"'mine' failed: ZeroDivisionError: .* \(line 3 of mine\.py\)"):
        prior(3)
    with pytest.raises(PluginError, match="'mine' failed: TypeError"):
        brought("gs2ci.priors", "mine")


@pytest.mark.parametrize("error", [InputError("no light"), MemoryError(), KeyboardInterrupt()], ids=repr)
def test_errors_that_say_enough_and_interruptions_pass_through_a_plug_in(error):
    def brought():
        raise error

    with pytest.raises(type(error)) as caught:
        called("mine", brought)
    assert caught.value is error


def test_without_plug_ins_the_command_says_how_to_make_one(gs2ci, capsys, monkeypatch):
    monkeypatch.setattr("gs2ci.api.plugins.installed", lambda _: [])
    assert gs2ci("plugins") == 0
    assert "docs/plugins.md" in capsys.readouterr().out
