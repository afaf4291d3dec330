"""`rhec lab` saves the project's notebooks as git holds them, so that running one changes nothing.

Outputs stay on the screen; `make figures studies` keeps those of build/notebooks/.
"""

import warnings

from nbformat import from_dict
from nbstripout import strip_output


def _as_git_holds_it(model, path, **_):
    """Take outputs and the version of Python out of a notebook that is about to be saved."""
    if model["type"] == "notebook" and path.strip("/").startswith("notebooks/"):
        model["content"] = strip_output(
            from_dict(model["content"]),
            keep_output=False,
            keep_count=False,
            keep_id=True,
            extra_keys=["metadata.language_info"],
        )


# The server sets a hook twice, and warns of the second time.
warnings.filterwarnings("ignore", "Overriding existing pre_save_hook")
get_config().FileContentsManager.pre_save_hook = _as_git_holds_it  # noqa: F821
