import cv2
import numpy as np
import pytest
import torch

from toolkit import ConfigError, EnvironmentFault, LinearImage, Measurement
from toolkit.measurement import ContourPoints, FitSummary, ResidualMap
from toolkit.report import draw_residuals, write_residuals
from toolkit.report.residuals import LESS, MORE, patch_side

SIDE = 4


def shot(width=200, height=120):
    return LinearImage(
        rgb=torch.full((1, 3, height, width), 0.2),
        clipped=torch.zeros(1, 1, height, width, dtype=torch.bool),
    )


def measured(sigma, *, left=60.0, top=40.0):
    """Patches side by side, as they lie from left to right and down."""
    rows, columns = np.shape(sigma)
    places = tuple(
        (left + SIDE * x + (SIDE - 1) / 2, top + SIDE * y + (SIDE - 1) / 2)
        for y in range(rows)
        for x in range(columns)
    )
    residuals = ResidualMap(place_px=places, sigma=tuple(np.ravel(sigma).tolist()))
    return Measurement(
        stage="sweep",
        fit=FitSummary(chi2_per_dof=1.0, pixels=1, iterations=1, residuals=residuals),
    )


def halves(picture):
    """The shot's part and the coloured one, above each other for a streak that lies flat."""
    return np.split(picture, 2, axis=0)


def patch(coloured, x, y, scale):
    """Middle of a patch; a margin of 6 px lies round the first one's middle, at 1.5 px in it."""
    return coloured[round((6 + SIDE * y + 1) * scale), round((6 + SIDE * x + 1) * scale)]


def test_more_light_is_orange_and_less_blue_the_stronger_the_surer():
    sigma = np.zeros((3, 12))
    sigma[1, 2], sigma[1, 5], sigma[1, 8] = 6.0, -6.0, -2.0
    plain, coloured = halves(draw_residuals(shot(), measured(sigma)))
    scale = plain.shape[1] / (12 * SIDE + 12 - 3)
    assert np.abs(patch(coloured, 2, 1, scale).astype(int) - MORE).max() <= 1
    assert np.abs(patch(coloured, 5, 1, scale).astype(int) - LESS).max() <= 1
    weak, none = patch(coloured, 8, 1, scale).astype(int), patch(coloured, 10, 1, scale)
    assert np.ptp(none) == 0
    assert np.abs(weak - (none.astype(int) + LESS) / 2).max() <= 2
    assert np.ptp(plain.reshape(-1, 3), axis=0).max() == 0


def test_noise_alone_stays_pale():
    sigma = np.random.default_rng(3).standard_normal((6, 20))
    coloured = halves(draw_residuals(shot(), measured(sigma)))[1].astype(float)
    assert np.quantile(np.ptp(coloured, axis=-1), 0.7) < 100


def test_an_upright_streak_has_its_map_beside_it():
    picture = draw_residuals(shot(), measured(np.zeros((14, 3))))
    assert picture.dtype == np.uint8
    assert picture.shape[0] > picture.shape[1]
    assert picture.shape[0] > 400  # enlarged


def test_a_streak_at_the_border_is_drawn_too():
    sigma = np.full((3, 6), 5.0)
    assert draw_residuals(shot(30, 20), measured(sigma, left=0.0, top=0.0)).size
    assert draw_residuals(shot(30, 20), measured(sigma, left=8.0, top=9.0)).size


def test_contours_are_drawn_where_they_lie():
    sides = tuple((60.0 + x, 45.0) for x in range(40))
    result = measured(np.zeros((3, 12)))
    contours = ContourPoints(left=sides, right=tuple((x, y + 3) for x, y in sides))
    lined = draw_residuals(
        shot(),
        Measurement(stage="sweep", fit=result.fit, contours=contours),
    )
    changed = (lined != draw_residuals(shot(), result)).any(-1)
    assert changed[: len(changed) // 2].sum() == 0
    assert changed[len(changed) // 2 :].any()


def test_the_side_of_the_patches_is_that_of_most_neighbours():
    assert patch_side(measured(np.zeros((4, 9))).fit.residuals) == SIDE
    assert patch_side(measured(np.zeros((40, 70))).fit.residuals) == SIDE
    assert patch_side(ResidualMap(place_px=((1.0, 2.0),), sigma=(1.0,))) == 1


@pytest.mark.parametrize("fit", [None, FitSummary(chi2_per_dof=1.0, pixels=1, iterations=1)])
def test_without_residuals_it_says_where_they_come_from(fit):
    with pytest.raises(ConfigError, match=r"stage contours leaves no residuals .* --stage sweep"):
        draw_residuals(shot(), Measurement(stage="contours", fit=fit))


def test_it_is_written_whole_or_not_at_all(tmp_path):
    result, path = measured(np.ones((3, 8))), tmp_path / "r.png"
    write_residuals(path, shot(), result)
    assert np.array_equal(cv2.imread(str(path))[..., ::-1], draw_residuals(shot(), result))
    with pytest.raises(EnvironmentFault):
        write_residuals(tmp_path / "none" / "r.png", shot(), result)
