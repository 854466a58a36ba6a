"""Pages: HTML in one file, with its pictures inside, that opens anywhere without a network."""

import base64
from collections.abc import Iterable, Sequence
from html import escape

_STYLE = """
:root { color-scheme: light dark; --line: #8884; --soft: #8882; }
body { font: 15px/1.5 system-ui, sans-serif; margin: 2em auto; max-width: 70em; padding: 0 1em; }
h1, h2 { line-height: 1.2; } h2 { margin-top: 2em; }
.wide { overflow-x: auto; } table { border-collapse: collapse; }
td, th { padding: .2em .7em; text-align: right; border-bottom: 1px solid var(--line); }
td:first-child, th:first-child { text-align: left; }
td.words, th.words { text-align: left; } td:not(.words) { white-space: nowrap; }
figure { margin: 1em 0; } img { max-width: 100%; height: auto; }
.row { display: flex; flex-wrap: wrap; gap: 1em; } .row figure { flex: 1 1 15em; margin: 0; }
.row img, .over img { width: 100%; image-rendering: pixelated; display: block; }
.over { position: relative; max-width: 40em; --at: 50%; }
.over img + img { position: absolute; inset: 0; clip-path: inset(0 0 0 var(--at)); }
.over input { width: 100%; margin: .3em 0 0; }
.grade { padding: .4em .8em; border-left: .4em solid #888; background: var(--soft); }
.good { border-color: #2a9d3a; } .usable { border-color: #c98a00; } .bad { border-color: #c62828; }
span.good { color: #2a9d3a; } span.usable { color: #b07800; } span.bad { color: #c62828; }
.swatch { display: inline-block; width: .9em; height: .9em; border: 1px solid var(--line);
  vertical-align: -.1em; margin-right: .4em; }
"""

#: The class of a grade's colour.
GRADES = {"exact": "good", "good": "good", "usable": "usable"}


def page(title: str, *parts: str) -> str:
    """Returns a page. **Arguments:** `parts`: pieces of HTML, one after the other."""
    body = "\n".join(parts)
    return (
        f"<!DOCTYPE html>\n<html lang='en'><head><meta charset='utf-8'><title>{escape(title)}"
        "</title><meta name='viewport' content='width=device-width, initial-scale=1'>"
        f"<link rel='icon' href='data:,'><style>{_STYLE}</style></head>\n"
        f"<body><h1>{escape(title)}</h1>\n{body}\n</body></html>\n"
    )


def heading(text: str) -> str:
    """Returns a heading of the second level."""
    return f"<h2>{escape(text)}</h2>"


def paragraph(text: str) -> str:
    """Returns a paragraph."""
    return f"<p>{escape(text)}</p>"


def verdict(text: str, grade: str) -> str:
    """Returns a sentence beside the colour of its grade. **Arguments:** `grade`: as `Trust`'s."""
    return f"<p class='grade {GRADES.get(grade, 'bad')}'>{escape(text)}</p>"


def listed(lines: Iterable[str]) -> str:
    """Returns a list; nothing of no lines."""
    items = "".join(f"<li>{escape(line)}</li>" for line in lines)
    return f"<ul>{items}</ul>" if items else ""


def table(columns: Sequence[str], rows: Iterable[Sequence[str]], words: Sequence[int] = ()) -> str:
    """Returns a table.

    **Arguments:** `rows`: cells in HTML. `words`: the columns of words, which begin at the left.
    """
    kind = lambda k: " class='words'" if k in words else ""
    head = "".join(
        f"<th scope='col'{kind(k)}>{escape(name)}</th>" for k, name in enumerate(columns)
    )
    line = lambda row: "".join(f"<td{kind(k)}>{cell}</td>" for k, cell in enumerate(row))
    body = "".join(f"<tr>{line(row)}</tr>" for row in rows)
    content = f"<thead><tr>{head}</tr></thead><tbody>{body}</tbody>"
    return f"<div class='wide'><table>{content}</table></div>"


def image(png: bytes, alt: str) -> str:
    """Returns a picture that the page holds itself."""
    data = base64.b64encode(png).decode()
    return f"<img alt='{escape(alt)}' src='data:image/png;base64,{data}'>"


def figure(picture: str, caption: str) -> str:
    """Returns a picture with words below it. **Arguments:** `picture`: as `image` returns."""
    return f"<figure>{picture}<figcaption>{escape(caption)}</figcaption></figure>"


def side_by_side(*figures: str) -> str:
    """Returns figures in a row, or one below the other where the page is narrow."""
    return f"<div class='row'>{''.join(figures)}</div>"


def slider(left: str, right: str, label: str) -> str:
    """Returns two pictures over one another, with a slider that says how much of each shows."""
    move = "this.parentNode.style.setProperty(&quot;--at&quot;, this.value + &quot;%&quot;)"
    return (
        f"<div class='over'>{left}{right}<input type='range' min='0' max='100' value='50' "
        f"step='any' aria-label='{escape(label)}' oninput='{move}'></div>"
    )
