"""Names in a page's text that would disturb it: those written from right to left, and those too long for one line.

A page's own words are English and short, so any other word in it is a name, of a controller or of a file. Beside one from right
to left the Unicode Bidirectional Algorithm, UAX #9, would order numbers and commas so, too; an isolate keeps that to itself.
"""

import re
import unicodedata
from html import escape

LONG = 16  # letters, more than which a line may break within
OPEN, CLOSE = "\N{FIRST STRONG ISOLATE}", "\N{POP DIRECTIONAL ISOLATE}"
# Spaces and punctuation of sentences end a name; its own are - and _.
NAME = re.compile(r"[^\s!-,./:-@\[-^`{-~]+")


def drawn_text(text: str) -> str:
    """A text as SVG and attributes have it, where no element can isolate a name: characters do."""
    return escape(NAME.sub(lambda found: f"{OPEN}{found[0]}{CLOSE}" if _leftward(found[0]) else found[0], text))


def page_text(text: str) -> str:
    """A text as HTML, in which names from right to left, and long ones, are `bdi` elements, which the style sheet breaks."""
    pieces, at = [], 0
    for found in NAME.finditer(text):
        if _leftward(found[0]) or len(found[0]) > LONG:
            pieces += [escape(text[at : found.start()]), f"<bdi>{escape(found[0])}</bdi>"]
            at = found.end()
    return "".join([*pieces, escape(text[at:])])


def _leftward(name: str) -> bool:
    return any(unicodedata.bidirectional(letter) in ("R", "AL", "AN") for letter in name)
