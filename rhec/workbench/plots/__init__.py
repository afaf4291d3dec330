"""The figures of the paper and of the studies, one function for each figure.

A figure function takes finished runs or tables and returns a matplotlib Figure with units on its
axes. `rhec.workbench.plots.style` provides the common style and saves figures. A notebook imports
only the modules of its figures, so that make repeats it only if one of these has changed.
"""
