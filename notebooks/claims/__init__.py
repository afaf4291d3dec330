"""The paper's claims as data, the runs that test them, and the verdicts: `ledger` judges,
`run_sets` and `experiments` make the evidence.
"""
