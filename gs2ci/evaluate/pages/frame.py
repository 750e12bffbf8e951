"""A page in one file: its frame, and the policy that keeps everything else out.

Here: `page`, `PageSection`, the template environment. Not here: what stands in a section (`pieces.py`).

Names come from files that anybody may have made. Escaping keeps them text; and should it ever fail, the page's
Content-Security-Policy names its one style and its one script by their hashes and forbids all else.
"""

import base64
import hashlib
import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, Final

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

# Characters that a page cannot hold (C0 controls, lone surrogates) and those that turn text around (bidi controls):
# a name made of them could pretend to be another.
_UNFIT: Final = re.compile(r"[\x00-\x08\x0b\x0c\x0e-\x1f\x7f\ud800-\udfff\u202a-\u202e\u2066-\u2069]")
REPLACEMENT: Final = "\ufffd"


@dataclass(frozen=True)
class PageSection:
    """One part of a page.

    Args:
        title: Its heading.
        body: Made of pieces (`pieces.py`).
        lead: A sentence under the heading.
        folded: Whether it opens only when asked; printed in any case.
    """

    title: str
    body: Markup
    lead: str = ""
    folded: bool = False


def page(title: str, sections: Sequence[PageSection], *, masthead: Markup | None = None, eyebrow: str = "gs2ci") -> str:
    """Build a whole page.

    Args:
        title: Of the window, and the heading unless a masthead brings its own.
        sections: In order.
        masthead: What stands on top (`pieces.masthead`).
        eyebrow: A few words above the title.
    """
    style, behaviour = _text("page.css"), _text("page.js") + _text("scene.js")
    return str(
        environment()
        .get_template("page.html")
        .render(
            title=fit(title),
            eyebrow=eyebrow,
            masthead=masthead,
            sections=list(zip(_anchors(sections), sections, strict=True)),
            style=Markup(style),  # noqa: S704  our own file
            behaviour=Markup(behaviour),  # noqa: S704  our own file
            style_hash=_policy_hash(style),
            behaviour_hash=_policy_hash(behaviour),
        )
    )


def piece(name: str, /, **values: Any) -> Markup:
    """Render one macro of `templates/pieces.html`."""
    macro = getattr(environment().get_template("pieces.html").module, name)
    rendered: Markup = macro(**values)
    return rendered


def fit(text: object) -> str:
    """Turn any value into text that a page can hold; characters that it cannot become �."""
    return _UNFIT.sub(REPLACEMENT, str(text))


@cache
def environment() -> Environment:
    """Get the templates: everything escaped, everything missing an error."""
    return Environment(
        loader=PackageLoader("gs2ci.evaluate.pages"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        finalize=_finalize,
    )


def _anchors(sections: Sequence[PageSection]) -> list[str]:
    """Name sections for links within the page; names that come again are counted."""
    found: list[str] = []
    for section in sections:
        name = "-".join(re.findall(r"[a-z0-9]+", section.title.lower())) or "section"
        taken = sum(other == name or other.startswith(f"{name}--") for other in found)
        found.append(f"{name}--{taken + 1}" if taken else name)
    return found


def _finalize(value: Any) -> Any:
    """Prepare what a template is about to print; markup passes."""
    return value if isinstance(value, Markup | int | float) else fit(value)


@cache
def _text(name: str) -> str:
    return (Path(__file__).parent / "templates" / name).read_text(encoding="utf-8")


def _policy_hash(text: str) -> str:
    return base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()
