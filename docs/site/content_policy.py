"""Content-Security-Policy of the report: what a browser lets its pages run and load.

Pages run the scripts of the report alone and load nothing from elsewhere, so that text which ends
up in a page as HTML by mistake, for example from a log, cannot run and cannot load anything. A
policy does not keep such text from leading to another page.
"""

import re
from base64 import b64encode
from hashlib import sha256
from importlib.resources import files

# A page from the disk has no origin, so that some browsers do not count other files as 'self'.
_FILES = "'self' file:"
_INLINE_SCRIPT = re.compile(r"<script>(.*?)</script>", re.DOTALL)


def _policy(scripts, rest):
    """A policy: which scripts run besides those of files, and the directives that differ."""
    directives = {
        "default-src": "'none'",
        "style-src": f"{_FILES} 'unsafe-inline'",
        "font-src": f"{_FILES} data:",
        "base-uri": "'none'",
        "script-src": f"{_FILES} {scripts}",
        "img-src": f"{_FILES} data:",
    }
    return "; ".join(f"{name} {sources}" for name, sources in (directives | rest).items())


def live_policy():
    """Return the policy of the live page, which runs WebAssembly."""
    return _policy("'wasm-unsafe-eval'", {"form-action": "'none'"})


def with_policy(html):
    """Return a page of the report with its policy, which allows the scripts of the theme alone.

    Args:
        html: The text of the page. Other scripts within it are not run.

    Returns:
        The text with a `<meta>` element at the beginning of `<head>`.
    """
    template = (files("furo") / "theme/furo/base.html").read_text(encoding="utf-8")
    digests = [sha256(script.encode()).digest() for script in _INLINE_SCRIPT.findall(template)]
    inline = " ".join(f"'sha256-{b64encode(digest).decode()}'" for digest in digests)
    # The form is that of the search.
    policy = _policy(inline, {"media-src": f"{_FILES} data:", "form-action": _FILES})
    meta = f'<meta http-equiv="Content-Security-Policy" content="{policy}">'
    return re.sub("<head>", lambda head: f"{head[0]}\n{meta}", html, count=1)
