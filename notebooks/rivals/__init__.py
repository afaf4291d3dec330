"""Rivals of the paper's estimators, and oracles, each a rhec.Estimator: {name: Estimator}.

`Scenario(estimator=RIVALS["augmented_ekf"])` drives one.
"""

from notebooks.rivals import filters, held_traction

RIVALS = filters.RIVALS | {name: held_traction.rival(name) for name in held_traction.TOLD}


def by_name(name):
    """What `Scenario.estimator` takes: a rival by its name, or the name of an estimator of rhec."""
    return RIVALS.get(name, name)
