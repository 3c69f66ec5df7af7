"""The pages: their blocks of commands, tables and code."""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from markdown_it import MarkdownIt

from tests.support.nodes import ROOT

PROGRAMS = ("telepulse", "sensing-node", "display-node", "make", "python", "pip", "docker")
# Programs that are not telepulse's.
OTHERS = ("source", "pre-commit", "curl", "ssh", "wg-quick", "promtool", "prometheus")
# Names of the streams of `telepulse record --lsl`.
NAMES = ("telepulse wrist", "telepulse finger", "telepulse events")
# Stands before a block whose commands a test runs, in the order of the page.
RUN = "<!-- run -->"


@dataclass(frozen=True)
class Block:
    """An indented or fenced block; an indented one has no language. run: it is marked so."""

    page: str
    line: int
    language: str
    text: str
    run: bool = False

    @property
    def place(self) -> str:
        return f"{self.page}:{self.line}"

    @property
    def is_shell(self) -> bool:
        """Return whether it holds commands, by the program it begins with."""
        return not self.language and self.text.split()[0] in (*PROGRAMS, *OTHERS)


def pages() -> list[Path]:
    named = [ROOT / name for name in ("README.md", "CONTRIBUTING.md")]
    return [*named, *sorted((ROOT / "docs").rglob("*.md"))]


def written(page: Path) -> str:
    """Return a page's text without its generated parts, with its lines in their places."""
    text = page.read_text(encoding="utf-8")
    generated = re.compile(r"<!-- from code.*?<!-- end -->", re.DOTALL)
    return generated.sub(lambda part: "\n" * part[0].count("\n"), text)


def blocks() -> Iterator[Block]:
    for page in pages():
        name, before = str(page.relative_to(ROOT)), ""
        for token in MarkdownIt().parse(written(page)):
            if token.type in ("fence", "code_block"):
                assert token.map is not None
                language = token.info.strip()
                yield Block(name, token.map[0] + 1, language, token.content, before == RUN)
            before = token.content.strip()


def commands(block: Block) -> Iterator[str]:
    """Yield the commands of a shell block, one line each, without comments."""
    for line in block.text.replace("\\\n", " ").splitlines():
        if words := re.sub(r"(^|\s)#\s.*", "", line).split():
            yield " ".join(words)


def commands_in_text() -> Iterator[str]:
    """Yield commands that stand as `code` in a sentence or a table."""
    for page in pages():
        for token in MarkdownIt().enable("table").parse(written(page)):
            for child in token.children or ():
                words = child.content.split()
                typed = len(words) > 1 and words[0] in PROGRAMS and child.content not in NAMES
                if child.type == "code_inline" and typed:
                    yield " ".join(words)
