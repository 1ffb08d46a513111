#!/usr/bin/env python3
"""Checks the built book: links, images and anchors resolve, every formula reaches the page as written, and code
blocks name their language and are valid in it.

    scripts/check_book.py BOOK      the folder that `mdbook build` has written

Markdown interprets backslashes, underscores and table bars; a formula that loses one is shown as text, or as another
formula. Each formula of a chapter is therefore looked up on the built page. Ends with the line `N problems`.
"""

import html
import html.parser
import json
import re
import sys
import tomllib
import urllib.parse
from pathlib import Path

SOURCE = Path(__file__).resolve().parent.parent / "docs" / "src"
LANGUAGES = {"arduino", "console", "csv", "ini", "json", "mermaid", "python", "rust", "sh", "text", "toml", "typescript", "xml"}
problems = []


def problem(place, what):
    problems.append(f"{place}: {what}")


class Page(html.parser.HTMLParser):
    """The references and anchors on a page, and its text without code."""

    def __init__(self, text):
        super().__init__(convert_charrefs=True)
        self.references, self.anchors, self.parts = [], set(), []
        self.in_code = 0
        self.feed(text)
        self.text = "".join(self.parts)

    def handle_starttag(self, tag, attributes):
        named = dict(attributes)
        self.anchors.update(filter(None, (named.get("id"), named.get("name") if tag == "a" else None)))
        self.references += [named[key] for key in ("href", "src") if named.get(key)]
        if tag in ("code", "script", "style"):
            self.in_code += 1
        elif not self.in_code:
            # A tag inside a formula breaks it, because MathJax finds formulas only in running text.
            self.parts.append("\0")

    def handle_endtag(self, tag):
        if tag in ("code", "script", "style"):
            self.in_code = max(0, self.in_code - 1)
        elif not self.in_code:
            self.parts.append("\0")

    def handle_data(self, data):
        if not self.in_code:
            self.parts.append(data)


def plain(text):
    return re.sub(r"\s+", " ", text).strip()


def fences(text):
    """Fenced blocks: line, language, content."""
    found, opened = [], None
    for number, line in enumerate(text.splitlines(), 1):
        mark = re.match(r"\s*(```+)\s*([^\s,`]*)", line)
        if mark and opened is None:
            opened = (number, mark.group(2), [])
        elif mark and not mark.group(2):
            found.append((opened[0], opened[1], "\n".join(opened[2])))
            opened = None
        elif opened is not None:
            opened[2].append(line)
    return found, opened


def check_code(chapter, text):
    blocks, opened = fences(text)
    if opened:
        problem(f"{chapter}:{opened[0]}", "a code block that does not end")
    for line, language, content in blocks:
        place = f"{chapter}:{line}"
        if language not in LANGUAGES:
            problem(place, f"a code block of language {language!r}, expected one of {', '.join(sorted(LANGUAGES))}")
        try:
            if language == "toml":
                tomllib.loads(content)
            elif language == "json":
                json.loads(content)
            elif language == "python":
                compile(content, place, "exec")
        except (ValueError, SyntaxError) as error:
            problem(place, f"not {language}: {error}")


def check_formulas(chapter, text, page):
    prose = re.sub(r"^\s*```.*?^\s*```", "", text, flags=re.S | re.M)
    prose = re.sub(r"(`+)(?:(?!\1).)+?\1", "", prose, flags=re.S)
    if re.search(r"(?<!\\)\\[(\[]", prose):
        problem(chapter, r"`\(` or `\[` in running text; write `\\(` or `$$`")
    written = re.findall(r"\\\\\((.*?)\\\\\)", prose, re.S), re.findall(r"\$\$(.*?)\$\$", prose, re.S)
    shown = re.findall(r"\\\((.*?)\\\)", page.text, re.S), re.findall(r"\$\$(.*?)\$\$", page.text, re.S)
    for kind in (0, 1):
        there = {plain(formula) for formula in shown[kind]}
        for formula in written[kind]:
            # Markdown's own escapes; `\,` and `\{` belong to TeX and would be lost.
            meant = re.sub(r"\\([\\_|*])", r"\1", formula)
            if plain(meant) not in there:
                problem(chapter, f"this formula does not reach the page as written: {plain(formula)[:100]}")


def check_references(path, page, pages):
    for reference in page.references:
        address = urllib.parse.urlsplit(reference)
        if address.scheme or reference.startswith("//"):
            if address.scheme not in ("http", "https", "mailto", "data"):
                problem(path.name, f"{reference}: scheme {address.scheme}")
            continue
        target = path if not address.path else (path.parent / urllib.parse.unquote(address.path)).resolve()
        if not target.exists():
            problem(path.name, f"{reference} leads nowhere")
        elif address.fragment and target in pages and urllib.parse.unquote(address.fragment) not in pages[target].anchors:
            problem(path.name, f"{reference}: no such heading")


def main(arguments):
    if len(arguments) != 1 or not (Path(arguments[0]) / "index.html").is_file():
        print(__doc__, file=sys.stderr)
        return 2
    book = Path(arguments[0]).resolve()
    chapters = [path for path in sorted(SOURCE.rglob("*.md")) if path.name != "SUMMARY.md"]
    built = {path.resolve(): Page(path.read_text(encoding="utf-8")) for path in book.rglob("*.html")}
    for path, page in built.items():
        if path.name not in ("print.html", "404.html", "toc.html"):
            check_references(path, page, built)
    formulas = 0
    for chapter in chapters:
        name = chapter.relative_to(SOURCE)
        page = built.get((book / name).with_suffix(".html"))
        if page is None:
            problem(name, "is not in the book")
            continue
        text = chapter.read_text(encoding="utf-8")
        check_code(name, text)
        check_formulas(name, text, page)
        formulas += text.count("$$") // 2 + text.count("\\\\(")
    for line in problems:
        print(line)
    print(f"{len(chapters)} chapters, {formulas} formulas, {len(problems)} problems")
    return 1 if problems else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
