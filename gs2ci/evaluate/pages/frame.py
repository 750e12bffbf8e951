"""A page in one file: its frame, and the policy that blocks all foreign content.

Here: `page`, `PageSection`, the template environment. Not here: the contents of a section (`pieces.py`).

Names come from files of unknown origin. Escaping keeps them text; if it should ever fail, the page's
Content-Security-Policy allows only its one style and its one script, by their hashes.
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
from markupsafe import Markup, escape

# Characters that a page cannot contain (C0 controls, lone surrogates) and those that reverse text (bidi controls), with
# which one name could look like another.
_UNFIT: Final = re.compile(r"[\x00-\x08\x0b\x0c\x0e-\x1f\x7f\ud800-\udfff\u202a-\u202e\u2066-\u2069]")
REPLACEMENT: Final = "\ufffd"


# Near the beginning of every page (`templates/page.html`).
PAGE_MARK: Final = b'<meta name="generator" content="gs2ci">'


@dataclass(frozen=True)
class PageSection:
    """One part of a page.

    Args:
        title: Its heading.
        body: Made of pieces (`pieces.py`).
        lead: A sentence under the heading.
        folded: Whether it is closed until the reader opens it; it is printed in any case.
    """

    title: str
    body: Markup
    lead: str = ""
    folded: bool = False


def page(title: str, sections: Sequence[PageSection], *, masthead: Markup | None = None, eyebrow: str = "gs2ci") -> str:
    """Build a whole page.

    Args:
        title: Title of the window, and the heading unless there is a masthead.
        sections: The sections in order.
        masthead: The top of the page (`pieces.masthead`).
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
    return macro(**values)


def fit(text: object) -> str:
    """Turn any value into text for a page; characters that a page cannot contain become �."""
    return _UNFIT.sub(REPLACEMENT, str(text))


def with_commands(text: object) -> Markup:
    """Set a sentence, escaped, with the commands in it, which stand between backticks, as code."""
    parts = fit(text).split("`")
    if len(parts) % 2 == 0:
        return escape(fit(text))
    return Markup().join(_command(part) if i % 2 else part for i, part in enumerate(parts))


def _command(text: str) -> Markup:
    """Set a command as code, in which no line ends after the hyphens of an option."""
    option = Markup('<span class="whole">{}</span>')
    words = [option.format(word) if word.startswith("-") else word for word in text.split(" ")]
    return Markup("<code>{}</code>").format(Markup(" ").join(words))


@cache
def environment() -> Environment:
    """Get the template environment: all text is escaped, a missing variable is an error."""
    made = Environment(
        loader=PackageLoader("gs2ci.evaluate.pages"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        finalize=_finalize,
    )
    made.filters["with_commands"] = with_commands
    return made


def _anchors(sections: Sequence[PageSection]) -> list[str]:
    """Return the sections' names for links within the page; repeated names get numbers."""
    found: list[str] = []
    for section in sections:
        name = "-".join(re.findall(r"[a-z0-9]+", section.title.lower())) or "section"
        taken = sum(other == name or other.startswith(f"{name}--") for other in found)
        found.append(f"{name}--{taken + 1}" if taken else name)
    return found


def _finalize(value: Any) -> Any:
    """Prepare a value that a template prints; markup is not changed."""
    return value if isinstance(value, Markup | int | float) else fit(value)


@cache
def _text(name: str) -> str:
    return (Path(__file__).parent / "templates" / name).read_text(encoding="utf-8")


def _policy_hash(text: str) -> str:
    return base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()
