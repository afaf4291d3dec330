"""Drawings of the paper's figures and of the studies, one function each.

Each takes finished runs or tables and returns a matplotlib Figure, whose axes name the units;
`rhec.workbench.plots.style` gives all of them one look and saves them. A notebook imports the
modules whose figures it shows and no others, so that make runs it again only when one of those has
changed.
"""
