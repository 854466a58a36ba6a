"""Makes pages complete in themselves: links to sources become names, formulas become MathML."""

import html
import re

from latex2mathml.converter import convert

#: A link to a file of the repository that is no page: GitHub follows it, the site has no such file.
SOURCE = re.compile(r"\[([^\]]+)\]\((?:\.\./)+(?!docs/)[\w./-]+\)")
FORMULA = re.compile(r'<(span|div) class="arithmatex">\s*\\([(\[])(.*?)\\[)\]]\s*</\1>', re.DOTALL)


def on_config(config):
    """Leaves out the page of a server's errors, whose addresses suit no folder of files."""
    config.theme.static_templates.discard("404.html")
    return config


def on_page_markdown(markdown: str, **_) -> str:
    """Unlinks files of the repository."""
    return SOURCE.sub(r"\1", markdown)


def on_page_content(content: str, **_) -> str:
    """Typesets formulas, which browsers show without scripts or fonts of ours."""
    return FORMULA.sub(typeset, content)


def typeset(found: re.Match) -> str:
    tag, opening, formula = found.groups()
    display = "block" if opening == "[" else "inline"
    return f'<{tag} class="formula">{convert(html.unescape(formula), display=display)}</{tag}>'
