"""Many runs."""

from dataclasses import fields

import pandas as pd

from rhec.closed_loop import simulate


def campaign(scenarios):
    """One row a scenario, in the order given: its fields and its metrics, as a DataFrame."""
    rows = [{field.name: getattr(scenario, field.name) for field in fields(scenario)} | simulate(scenario).metrics for scenario in scenarios]
    return pd.DataFrame(rows)
