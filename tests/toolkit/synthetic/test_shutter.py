import numpy as np
import pytest
import torch

from toolkit.synthetic.shutter import Shutter


def test_rows_are_exposed_one_after_the_other():
    shutter = Shutter(exposure=1.0, row_delay=0.5, rows=4)
    assert shutter.is_rolling
    assert shutter.end == 2.5
    # the slice from 0.9 to 1.1 s: row 0 closes within it, 1 and 2 are open, row 3 not yet
    shares = shutter.shares(range(-1, 5), 1.0, 0.2)
    assert shares.tolist() == pytest.approx([0, 0.5, 1, 0.5, 0, 0])


def test_slices_add_up_to_the_exposure_in_every_row():
    shutter = Shutter(exposure=0.01, row_delay=1.7e-5, rows=100)
    length = shutter.end / 333
    total = sum(shutter.shares(range(100), (i + 0.5) * length, length) for i in range(333))
    assert np.allclose(total * length, 0.01, rtol=1e-9)


def test_a_global_shutter_exposes_all_rows_at_once():
    shutter = Shutter(exposure=0.01, row_delay=0.0, rows=100)
    assert not shutter.is_rolling
    assert (shutter.shares(range(100), 0.005, 0.01) == 1).all()


def test_rows_outside_the_picture_are_never_exposed():
    shutter = Shutter(exposure=1.0, row_delay=0.5, rows=4)
    time = torch.tensor([0.2, 0.2, 0.2, 2.2, 2.2])
    top, bottom = torch.tensor([-9, -9, 2, 2, 4]), torch.tensor([-1, 1, 9, 9, 9])
    assert shutter.exposes(time, top, bottom).tolist() == [False, True, False, True, False]
