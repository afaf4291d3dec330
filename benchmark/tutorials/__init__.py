"""do-mpc's first tutorials, the control and the estimation of three rotating masses, written for
do-mpc and for rhec. What a user writes is counted; `make bench` and the tests run both.
"""
