import pytest
import torch

from toolkit.synthetic import (
    checked_background,
    flat_background,
    panelled_background,
    textured_background,
)

COLOUR = (0.3, 0.4, 0.5)


@pytest.mark.parametrize("make", [textured_background, panelled_background, checked_background])
def test_backgrounds_stay_within_their_contrast(make):
    picture = make(90, 60, colour=COLOUR, contrast=0.08)
    assert picture.shape == (3, 60, 90)
    deviation = (picture - torch.tensor(COLOUR)[:, None, None]).abs()
    assert deviation.max() <= 0.08 + 1e-6
    assert deviation.max() > 0.05


@pytest.mark.parametrize("make", [textured_background, panelled_background])
def test_seeds_repeat_and_differ(make):
    assert torch.equal(make(50, 40, seed=1), make(50, 40, seed=1))
    assert not torch.equal(make(50, 40, seed=1), make(50, 40, seed=2))


def test_a_texture_is_smooth_and_coloured():
    picture = textured_background(200, 150, contrast=0.1)
    assert picture.diff(dim=2).std() < 0.4 * picture.std()
    assert (picture[0] - picture[2]).std() > 0.01


def test_a_flat_background_is_one_colour():
    picture = flat_background(5, 4, COLOUR)
    assert torch.equal(picture, torch.tensor(COLOUR)[:, None, None].expand(3, 4, 5))


def test_a_checker_changes_at_its_squares():
    picture = checked_background(64, 32, square=16)
    assert torch.equal(picture[:, :16, :16], picture[:, 16:, 16:32])
    assert (picture[:, 0, 15] != picture[:, 0, 16]).all()


def test_dark_backgrounds_do_not_go_below_zero():
    assert textured_background(40, 40, colour=(0.01, 0.01, 0.01), contrast=0.1).min() == 0
