"""What is wrong with the texts of a figure: those that are too small in print."""

import re
import zlib

import numpy as np


def sizes_in_print(pdf):
    """The sizes [pt] of the texts of a figure in a PDF that Matplotlib wrote.

    A text with indices, which are smaller, counts by its largest letters.
    """
    streams = re.findall(rb"stream\r?\n(.*?)\r?\nendstream", pdf.read_bytes(), re.DOTALL)
    sizes = []
    for stream in streams:
        try:
            drawn = zlib.decompress(stream)
        except zlib.error:  # of a font, for example
            continue
        for block in re.findall(rb"\bBT\b(.*?)\bET\b", drawn, re.DOTALL):
            found = re.findall(rb"/[\w-]+ ([\d.]+) Tf", block)
            sizes.append(max(map(float, found), default=np.inf))
    return sizes
