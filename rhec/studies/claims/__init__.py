"""The paper's claims as data, the runs that test them, and the verdicts: `ledger` says what,
`evidence` on which runs, `rules` by what rule.
"""
