"""What the held-out recording decides, and what of it does not count."""

from types import SimpleNamespace

import numpy as np
import pytest

from greygate.mismatch import held_out


@pytest.mark.parametrize(("windows", "counted"), [(6, 50), (4, 60)])
def test_of_many_windows_the_first_does_not_count(windows, counted, monkeypatch):
    """What acted before it is not recorded; where there are few, all count. So of each recording."""
    each = [SimpleNamespace(restarts=np.arange(0, 60, 60 // windows)), SimpleNamespace(restarts=np.array([0]))]
    model = SimpleNamespace(
        rig=SimpleNamespace(settle=0), target=np.zeros((100, 1)), each=each, pieces=[slice(0, 60), slice(60, 100)]
    )
    monkeypatch.setattr(held_out, "by_rule", lambda *_: (np.arange(100.0)[:, None], np.ones(100, bool)))
    errors = held_out._errors(model, {})
    assert errors[:, 0].tolist() == (-np.arange(60.0 - counted, 100.0)).tolist()
