"""What a notebook shows of a run."""

import base64
import html
import io

from rhec.simulation.log_page import METRICS


def html_of(run):
    """The scenario, the table of the metrics, and the picture of a Run, as HTML."""
    picture = io.BytesIO()
    run.plot().savefig(picture, format="png", dpi=100)
    data = base64.b64encode(picture.getvalue()).decode()
    return (
        f"<p><code>{html.escape(repr(run.scenario))}</code></p>"
        f'<div style="display: flex">{table_of(run.metrics)}'
        f'<img src="data:image/png;base64,{data}" alt="path, errors and traction"></div>'
    )


def table_of(metrics):
    """The Metrics of a run as an HTML table, with their units and, as tooltips, definitions."""
    rows = []
    for name, value in metrics.items():
        unit, text = METRICS[name]
        cells = f"<td>{name}</td><td>{_rounded(value)}</td><td>{unit}</td>"
        rows.append(f'<tr title="{html.escape(text)}">{cells}</tr>')
    return f"<table>{''.join(rows)}</table>"


def _rounded(value):
    return f"{value:.4g}" if isinstance(value, float) else str(value)
