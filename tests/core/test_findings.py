import ast
import importlib
import inspect
import re
from functools import cache
from pathlib import Path

import pytest

import gs2ci
from gs2ci import cli
from gs2ci.core.findings import REMARK, Code, finding, texts

ROOT = Path(gs2ci.__file__).parent
REGISTRY = ROOT / "core" / "findings.py"
# `gs2ci import --scale`, or `--scale` alone: the command before it in the same remedy.
MENTION = re.compile(r"gs2ci (\w+)|--([a-z][a-z-]*)")


def product_files():
    return [path for path in ROOT.rglob("*.py") if path != REGISTRY]


@cache
def codes_named():
    """Return the codes that the product names outside the registry, pages and rules that only read them included."""
    return {
        node.attr
        for path in product_files()
        if "pages" not in path.parts
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id == "Code"
    }


def calls():
    """List the calls that make a finding of a code which stands there by name, with the figures they give."""
    for path in product_files():
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "finding":
                code = node.args[0]
                name = code.attr if isinstance(code, ast.Attribute) else None
                yield f"{path.name}:{node.lineno}", name, {keyword.arg for keyword in node.keywords}


def test_every_code_has_a_text_and_every_text_a_code():
    assert set(texts()) == set(Code)


def test_every_code_is_found_somewhere():
    assert [code for code in Code if code.name not in codes_named()] == []


def test_every_finding_gives_the_figures_of_its_sentence():
    by_name = [(place, Code[name], given) for place, name, given in calls() if name is not None]
    assert len(by_name) > 50
    for place, code, given in by_name:
        assert code.figures <= given, place


def test_sentences_and_remedies_are_sentences():
    assert [code for code in Code if code.value != code.name.lower()] == []
    begin = [code for code in Code if code.sentence[0].isupper() or code.sentence[0] == "{"]
    end = [code for code in Code if code.sentence.endswith((".", "{sentence}")) and code.remedy.endswith((".", ")."))]
    assert begin == end == [code for code in Code if "--" not in code.sentence] == list(Code)


def parameters(command):
    module = importlib.import_module(cli.COMMANDS[command][0])
    found = [inspect.signature(module.run)] if hasattr(module, "run") else []
    return {name for signature in found for name in signature.parameters}


def test_remedies_name_only_commands_and_options_that_exist():
    for code in Code:
        command = "reconstruct"
        for named, option in MENTION.findall(code.remedy):
            command = named or command
            assert command in cli.COMMANDS, code
            assert not option or option.replace("-", "_") in parameters(command), f"{code}: {command} --{option}"


def test_a_finding_holds_its_sentence_its_figures_and_the_remedy_of_a_doubt():
    dark = finding(Code.SATURATED, share=0.25)
    assert dark.sentence == "25% of the pixels are saturated: they give only a lower bound of the light."
    assert dark.figures == {"share": 0.25}
    assert dark.advice == f"{dark.sentence} {Code.SATURATED.remedy}"


def test_a_remark_asks_for_nothing():
    stalled = finding(Code.FIT_STALLED, best=450)
    assert stalled.code.weight is REMARK
    assert stalled.advice == stalled.sentence


def test_a_figure_that_is_missing_is_an_error():
    with pytest.raises(KeyError, match="share"):
        finding(Code.SATURATED)
