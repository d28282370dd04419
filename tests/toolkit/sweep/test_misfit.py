from dataclasses import replace

import pytest
import torch

from toolkit.box_filter import box_mean
from toolkit.sweep.fit import fit_sweep
from toolkit.sweep.misfit import (
    COVERED,
    beside_excess,
    bulk_excess,
    is_noise,
    look_for_misfit,
    mean_square,
    patches_beside,
    with_coarse_misfit,
)

SEEDS = 20


def fitted(seen, frame):
    return fit_sweep(seen.model(), seen.truth(), frame, doubt=1.0)


@pytest.fixture(scope="module")
def plain(streak):
    return streak(length_widths=2.0)


def test_noise_alone_is_no_misfit(plain):
    found = [look_for_misfit(plain.again(seed).fit()) for seed in range(SEEDS)]
    assert sum(misfit.significant for misfit in found) <= 2
    assert all(misfit.pixels == pytest.approx(1, abs=0.1) for misfit in found)
    factors = torch.tensor([misfit.factor for misfit in found])
    assert (factors >= 1).all()
    assert float(factors.median()) < 1.05
    patches, lanes = torch.tensor([[m.patches, m.lanes] for m in found]).mean(0).tolist()
    # what is fitted takes its share, most from lanes, of which there are few
    assert 0.8 < patches < 1.1
    assert 0.6 < lanes < 1.1


def test_noise_that_is_alike_nearby_and_weaker_than_stated_is_no_misfit(plain):
    """As of what is put together from the cells of a mosaic."""
    frame, clean = plain.frame(), plain.clean().frame()
    noise = box_mean((frame.signal - clean.signal)[None], 3)[0]
    misfit = look_for_misfit(fitted(plain, replace(clean, signal=clean.signal + noise)))
    assert misfit.pixels < 0.2
    assert 2 * misfit.pixels < misfit.patches < 1.2
    assert not misfit.significant


def test_each_patch_says_where_it_is(plain):
    fit = plain.fit()
    misfit = look_for_misfit(fit)
    assert misfit.patch_place.shape == (len(misfit.patch_sigma), 2)
    covered = fit.pixels.place[fit.seen.coverage.alpha > COVERED]
    assert torch.cdist(misfit.patch_place, covered).amin(1).max() < 4
    assert float(misfit.patch_sigma.square().mean()) == pytest.approx(misfit.patches)


def smooth_noise(seen, size):
    """Noise of the same strength in each pixel, alike in neighbours."""
    generator = torch.Generator().manual_seed(4)
    shape = seen.shot.clean_image.shape
    raw = torch.randn(shape, generator=generator)
    soft = torch.nn.functional.avg_pool2d(raw[None], size, 1, size // 2)[0]
    return seen.noise * soft / soft.std()


def test_noise_alike_in_neighbours_widens(plain):
    frame = replace(plain.frame(), signal=plain.shot.clean_image + smooth_noise(plain, 5))
    misfit = look_for_misfit(fitted(plain, frame))
    assert misfit.pixels < 1.1
    assert misfit.is_patchy
    assert misfit.significant
    # 25 pixels are alike, of which patches of 64 cut some off
    assert 3 < misfit.factor < 25


def test_noise_alone_is_no_coarse_misfit(plain):
    fits = [plain.again(seed).fit() for seed in range(SEEDS)]
    pairs = [(look_for_misfit(fit), fit) for fit in fits]
    assert sum(with_coarse_misfit(*pair).factor > pair[0].factor for pair in pairs) <= 1


def test_what_is_alike_over_many_patches_widens_more(streak):
    """Blotches of 25 px, a third of the noise: each patch of 8 px shows little of them."""
    seen = streak(width_px=60, length_widths=2.0)
    frame = seen.frame()
    blotches = smooth_noise(seen, 25) / 3
    fit = fitted(seen, replace(frame, signal=seen.shot.image.rgb[0] + blotches))
    fine = look_for_misfit(fit)
    coarse = with_coarse_misfit(fine, fit)
    assert coarse.is_patchy
    assert coarse.factor > 1.2 * fine.factor
    assert coarse.factor > 1.5 * fine.patches
    assert coarse.patches == fine.patches


def test_what_all_of_the_streak_misses_widens(plain):
    """A stripe along the streak, a tenth of the ball's contrast: too weak for single pixels."""
    frame = plain.frame()
    fit = fitted(plain, frame)
    passage, place = fit.seen.coverage.passage, fit.pixels.place.long()
    offset = passage.side * (1 - passage.room / fit.model.ball_radius**2).clamp_min(0).sqrt()
    is_striped = (offset > 0.2) & (offset < 0.5)
    column, row = place[is_striped].mT
    signal = frame.signal.clone()
    signal[:, row, column] += 0.04 * fit.seen.coverage.alpha[is_striped].float()
    misfit = look_for_misfit(fitted(plain, replace(frame, signal=signal)))
    assert misfit.is_common
    assert misfit.pixels < 1.5
    assert misfit.factor > max(2.0, misfit.pixels)


def test_noise_larger_than_stated_widens_as_much(plain):
    misfit = look_for_misfit(fitted(plain, plain.frame().noisier(0.25)))
    assert misfit.pixels == pytest.approx(4, rel=0.1)
    assert misfit.factor >= misfit.pixels


def test_noise_smaller_than_stated_is_told_but_narrows_nothing(plain):
    misfit = look_for_misfit(fitted(plain, plain.frame().noisier(4.0)))
    assert misfit.pixels == pytest.approx(0.25, rel=0.1)
    assert misfit.factor == 1


def test_the_bulk_does_not_see_a_few_wild_pixels(plain):
    frame = plain.frame()
    signal = frame.signal.clone()
    column, row = plain.scene.camera.project(plain.points(3))[1].round().long().tolist()
    signal[:, row - 2 : row + 3, column - 2 : column + 3] += 0.2
    seen = fitted(plain, replace(frame, signal=signal)).seen
    assert mean_square(seen) > 1.2
    assert bulk_excess(seen) == pytest.approx(1, abs=0.1)


def dirt(seen, count, seed):
    """The picture with specks of three by three pixels all over the streak."""
    generator = torch.Generator().manual_seed(seed)
    covered = (seen.shot.alpha > 0.02).nonzero()
    chosen = covered[torch.randperm(len(covered), generator=generator)[:count]]
    frame = seen.frame()
    signal = frame.signal.clone()
    for row, column in chosen.tolist():
        signal[:, row - 1 : row + 2, column - 1 : column + 2] = 0.05
    return replace(frame, signal=signal)


@pytest.mark.parametrize("seed", range(3))
def test_specks_of_dirt_hardly_move_the_answer(streak, seed):
    seen = streak(width_px=40, length_widths=2.0)
    clean, dirty = seen.fit(), fitted(seen, dirt(seen, 25, seed))
    assert dirty.converged
    std = clean.path_covariance.diagonal().sqrt()
    gap = (dirty.parameters[:6] - clean.parameters[:6]).abs()
    misfit = look_for_misfit(dirty)
    # two hundred pixels of four thousand, twenty to forty standard deviations off each
    assert (gap < std * misfit.factor**0.5).all()
    assert misfit.factor > 1.2


@pytest.mark.parametrize("excess", [1.0, 4.0])
def test_squares_are_counted_as_the_single_pixels_they_stand_for(streak, excess):
    """Noise alone, and broad stripes, which squares show much better."""
    seen = streak(width_px=60, length_widths=2.0)
    whole = seen.frame()
    stripes = (torch.arange(whole.signal.shape[-1]) // 9 % 2) * 2 - 1
    for strength in (0.0, 0.5):
        light = whole.signal + strength * seen.noise * stripes
        frame = replace(whole, signal=light).noisier(excess)
        by_pixels, by_squares = (
            fit_sweep(seen.model(), seen.truth(), frame, contrast=contrast)
            for contrast in (None, 1.0)
        )
        assert len(by_squares.pixels.squares) == 2
        expected = look_for_misfit(by_pixels).pixels
        assert look_for_misfit(by_squares).pixels == pytest.approx(expected, rel=0.06)


def test_what_changed_beside_the_ball_is_told_from_noise(plain):
    fit = plain.fit()
    assert beside_excess(fit) == pytest.approx(1, abs=0.6)
    is_beside = fit.seen.coverage.alpha <= COVERED
    shadow = replace(fit.seen, residual=fit.seen.residual - 0.7 * is_beside)
    assert beside_excess(replace(fit, seen=shadow)) > 4
    covered = replace(fit.seen.coverage, alpha=torch.ones_like(fit.seen.coverage.alpha))
    assert beside_excess(replace(fit, seen=replace(fit.seen, coverage=covered))) == 1


def smoothed(picture, clean):
    """The same with noise that is alike over a few pixels, as a compressed picture has it."""
    return clean + torch.nn.functional.avg_pool2d((picture - clean)[None], 3, 1, 1)[0]


def test_noise_that_is_correlated_shows_beside_the_streak_too(plain):
    white, shot = plain.frame(), plain.shot
    assert patches_beside(plain.fit(), white) == pytest.approx(1, abs=0.3)
    noise = white.signal - shot.clean_image
    alike = replace(
        white,
        signal=smoothed(white.signal, shot.clean_image),
        ground=smoothed(white.ground, shot.clean_background),
        shot_variance=white.shot_variance / 9,
        ground_variance=white.ground_variance / 9,
    )
    assert float(noise.std()) == pytest.approx(plain.noise, rel=0.05)
    fit = fitted(plain, alike)
    misfit = with_coarse_misfit(look_for_misfit(fit), fit)
    assert misfit.significant
    assert patches_beside(fit, alike) == pytest.approx(9, rel=0.4)
    assert is_noise(fit, misfit, alike)


def test_what_only_the_streak_shows_is_no_noise(plain):
    """A stripe along the path, in noise of single pixels."""
    frame = plain.frame()
    signal = frame.signal.clone()
    signal[:, :, signal.shape[-1] // 2 - 3 :][:, :, :6] *= 1.1
    striped = replace(frame, signal=torch.where(plain.shot.alpha > 0.02, signal, frame.signal))
    fit = fitted(plain, striped)
    misfit = with_coarse_misfit(look_for_misfit(fit), fit)
    assert misfit.significant
    assert not is_noise(fit, misfit, striped)
