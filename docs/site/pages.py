"""Pages of the documentation site that are made while it is built (mkdocs calls this file as a hook).

    reference/commands.md   every command's help, as `--help` prints it
    reference/python.md     every public name of `gs2ci`, from its docstring and its types
    tutorials/*.md          the notebooks of docs/tutorials, their words and their code
    commands                the section of the commands' own pages, in the order of `gs2ci --help`

Here too: a link that leads out of docs/ becomes one to the repository's file where the site knows its address, else its
text alone. Not here: what the other pages say.
"""

import contextlib
import html
import io
import json
import os
import re
import sys
from pathlib import Path
from typing import Any
from unittest import mock

ROOT = Path(__file__).resolve().parents[2]
for _folder in (".", "drivers", "calibration", "sims"):
    sys.path.insert(0, str(ROOT / _folder))

OUTSIDE = re.compile(r"\[([^\]]+)\]\(((?:\.\./)+[^)#]*|rigs|\.\./rigs)(?:#[^)]*)?\)")


def on_config(config: Any) -> Any:
    """Put the commands' pages into the navigation, in the order in which the help lists them."""
    from gs2ci import cli

    pages = [{name: f"commands/{name}.md"} for name in cli.COMMANDS if (ROOT / f"docs/commands/{name}.md").is_file()]
    for section in config.nav:
        if isinstance(section, dict) and "Reference" in section:
            section["Reference"] = [
                {"Commands": pages} if entry == "commands" else entry for entry in section["Reference"]
            ]
        if isinstance(section, dict) and "Tasks" in section:
            section["Tasks"] = [
                {"Tutorials": [f"tutorials/{path.stem}.md" for path in notebooks()]} if entry == "tutorials" else entry
                for entry in section["Tasks"]
            ]
    return config


def on_files(files: Any, config: Any) -> Any:
    """Add the pages that are made."""
    from mkdocs.structure.files import File

    made = {"reference/commands.md": commands_page(), "reference/python.md": python_page()}
    made |= {f"tutorials/{path.stem}.md": notebook_page(path) for path in notebooks()}
    for name, text in made.items():
        files.append(File.generated(config, name, content=text))
    return files


def on_page_markdown(markdown: str, page: Any, config: Any, files: Any) -> str:
    """Leave links that lead out of the site as text."""
    here = Path(config.docs_dir) / page.file.src_uri

    def kept(link: re.Match[str]) -> str:
        target = (here.parent / link[2]).resolve()
        inside = target.is_relative_to(config.docs_dir) and target.is_file() and "plugin-template" not in target.parts
        return link[0] if inside else link[1]

    return OUTSIDE.sub(kept, re.sub(r"(\]\((?:tutorials/)?[\w-]+)\.ipynb\)", r"\1.md)", markdown))


def notebooks() -> list[Path]:
    """Return the notebooks, in their order."""
    return sorted((ROOT / "docs" / "tutorials").glob("*.ipynb"))


def notebook_page(path: Path) -> str:
    """Return a notebook as a page: words as they are, code as blocks; pictures come when it is run."""
    parts = []
    for cell in json.loads(path.read_text(encoding="utf-8"))["cells"]:
        text = "".join(cell["source"])
        parts.append(text if cell["cell_type"] == "markdown" else f"```python\n{text}\n```")
    return "\n\n".join([*parts, f'<a href="{path.name}">The notebook itself</a>: `docs/tutorials/{path.name}`.']) + "\n"


def commands_page() -> str:
    """Return the page of every command's help."""
    from gs2ci import cli

    parts = ["# Help of every command\n\nAs `gs2ci COMMAND --help` prints it.\n"]
    parts += [
        f'\n## gs2ci {name}\n\n<pre class="help"><code>{html.escape(help_of(name))}</code></pre>\n'
        for name in cli.COMMANDS
    ]
    return "".join(parts)


def help_of(command: str) -> str:
    """Return what a command prints for `--help`, 88 characters wide, as the site shows them, and without colours."""
    from gs2ci import cli

    said = io.StringIO()
    plain = {"COLUMNS": "88", "NO_COLOR": "1", "TERM": "dumb"}
    with (
        mock.patch.dict(os.environ, plain),
        mock.patch.object(sys, "argv", ["gs2ci", command, "--help"]),
        contextlib.redirect_stdout(said),
        contextlib.suppress(SystemExit),
    ):
        cli.main()
    return re.sub(r"\x1b\[[0-9;]*m", "", said.getvalue()).strip()


def python_page() -> str:
    """Return the page of every public name, to be filled from the docstrings."""
    import gs2ci

    names = [name for name in gs2ci.__all__ if not name.startswith("__")]
    blocks = [f"\n::: {gs2ci._MODULE_OF[name]}.{name}\n" for name in sorted(names, key=str.casefold)]
    return "# Python interface\n\nEvery public name of `gs2ci`; `import gs2ci` loads none of them.\n" + "".join(blocks)
