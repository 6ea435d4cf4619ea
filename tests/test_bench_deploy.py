"""The study of convergence: orders are those of the sequences that it is given."""

import numpy as np
import pytest

from wrod.bench.deploy import changes


@pytest.mark.parametrize("order", [1, 2])
def test_order_of_convergence_is_read_from_successive_changes(order):
    h = 0.5 ** np.arange(4)
    laid = [np.array([[0.0, 0.0], [0.03 * x**order, 0.04 * x**order]]) for x in h]
    study = [{"error_mean": 0.2 + 0.1 * x**order} for x in h]
    rows = changes(laid, study)
    assert rows[0] == dict.fromkeys(rows[0])
    assert rows[1]["change_cm"] == pytest.approx(100 * 0.05 * (1 - 0.5**order))
    assert rows[1]["order"] is None
    for row in rows[2:]:
        assert row["order"] == pytest.approx(order)
        assert row["error_order"] == pytest.approx(order)


def test_sequences_that_stand_still_have_no_order():
    rows = changes([np.zeros((2, 2))] * 3, [{"error_mean": 0.1}] * 3)
    assert rows[2]["change_cm"] == 0.0
    assert rows[2]["order"] is None
