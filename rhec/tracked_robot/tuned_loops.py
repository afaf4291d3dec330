"""Controller and estimator tuned together, {world: {contestant: fields of Scenario}}.

Source: `python -m rhec.workbench.studies.fair_tuning WORLD`, with EVALUATIONS for each unknown on
the training seeds 1000 to 1023, drives of 240 s.
"""

TUNED: dict[str, dict[str, dict]] = {}
