"""Captions of a notebook's pictures, which stand in its prose, and alternative texts of them."""

import html
import re
import textwrap

from latex2mathml.converter import convert

_LONGEST = 250  # characters of an alternative text


def with_captions(notebook):
    """The cells of code of a notebook, each with the caption above it, in Markdown.

    That is the last paragraph that begins with "Figure", else the last one.
    """
    caption = ""
    for cell in notebook.cells:
        if cell.cell_type == "code":
            yield cell, caption
        else:
            prose = re.sub(r"(?m)^#.*$", "", cell.source).strip()
            paragraphs = prose.split("\n\n")
            figures = [each for each in paragraphs if each.startswith("**Figure")]
            caption = (figures or paragraphs)[-1]


def alternative_text(caption):
    """What is read aloud in place of a picture with this caption."""
    words = re.sub(r"[*#`]", "", without_links(_with_plain_formulas(caption)))
    return textwrap.shorten(words, _LONGEST, placeholder=" …")


def _with_plain_formulas(markdown):
    """A text in Markdown with the letters of its formulas: θ^−θ for $\\hat\\theta - \\theta$."""

    def letters(formula):
        mathml = convert(formula[1]).replace("<msqrt>", "√")
        return html.unescape(re.sub(r"<[^>]*>", "", mathml))

    return re.sub(r"\$([^$]+)\$", letters, markdown)


def without_links(markdown):
    """A text in Markdown with the words of its links alone."""
    return re.sub(r"\[([^]]*)\]\([^)]*\)", r"\1", markdown)
