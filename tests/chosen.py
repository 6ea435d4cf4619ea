"""The device of SolverDER's tests: WROD_TEST_DEVICE=cuda:0 runs them on a GPU."""

import os

DEVICE = os.environ.get("WROD_TEST_DEVICE", "cpu")
