"""Values by flat labels: one model of many rows is what the rows make one by one."""

from __future__ import annotations

import numpy as np
import pytest

from fitter import models
from fitter.models.labelled import place, with_values


def test_rows_together_are_the_rows_one_by_one():
    model = models.create("ward", channels=["R", "G[2]"], kd=[0.1, 0.2], ks=[0.3, 0.4], alpha=0.5)
    labels = ("ks[G[2]]", "alpha", "relative_noise[R]")
    rows = np.array([[0.6, 0.7, 9.0], [0.8, 0.9, 9.0]])
    together = with_values(model, labels, rows)
    for k, row in enumerate(rows):
        alone = with_values(model, labels, row)
        assert np.asarray(alone.values["ks"]).tolist() == [pytest.approx(0.3), row[0]]
        assert float(alone.values["alpha"]) == row[1]
        for name, value in alone.values.items():
            np.testing.assert_array_equal(together.values[name][k], value)
    assert place("ks[G[2]]", model.channels) == ("ks", (1,))
    assert place("alpha", model.channels) == ("alpha", ())
