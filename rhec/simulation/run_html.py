"""What a notebook shows of a run."""

import base64
import html
import io

from rhec.plot import overview
from rhec.simulation.log_page import METRICS


def html_of(run):
    """The scenario, a table of the metrics, and the picture of a Run, as HTML."""
    rows = "".join(
        f"<tr><td>{name}</td><td>{_rounded(value)}</td><td>{METRICS[name][0]}</td></tr>"
        for name, value in run.metrics.items()
    )
    picture = io.BytesIO()
    # Without the band, since a result of a cell must not wait for a compiler.
    overview(run).savefig(picture, format="png", dpi=100)
    data = base64.b64encode(picture.getvalue()).decode()
    return (
        f"<p><code>{html.escape(repr(run.scenario))}</code></p>"
        f'<div style="display: flex"><table>{rows}</table>'
        f'<img src="data:image/png;base64,{data}" alt="path, errors and traction"></div>'
    )


def _rounded(value):
    return f"{value:.4g}" if isinstance(value, float) else str(value)
