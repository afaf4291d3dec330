"""Packages that campaigns can do without."""

import importlib


def optional(module, purpose):
    """Import an optional package, or say in one sentence what to install."""
    try:
        return importlib.import_module(module)
    except ImportError:
        raise ImportError(
            f"{purpose} needs {module}, which is not installed: pip install {module}"
        ) from None
