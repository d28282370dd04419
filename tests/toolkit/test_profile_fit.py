from dataclasses import fields, replace

import pytest
import torch

from plugins.uniform import Uniform
from toolkit.profile_fit import fit_profiles, refine_profiles
from toolkit.profile_model import Skew
from toolkit.semi_ellipse import semi_ellipse
from toolkit.types import ProfileFlag, Profiles

BALL = (0.8, 0.5, 0.1)
GROUND = 0.3
NOISE = 0.01
BLUR = 0.7
TRUE_SKEW = 0.05
OFFSET = torch.arange(-22.0, 23.0).double()


FIELDS = tuple(field.name for field in fields(Profiles))


def made_profiles(count=300, seed=0, noise=NOISE, skew=0.0, opacity=0.25, half_width=14.0):
    """Noisy profiles of known semi-ellipses before a noisy grey ground, and their parameters."""
    generator = torch.Generator().manual_seed(seed)

    def normal(*shape):
        return torch.randn(*shape, generator=generator, dtype=torch.float64)

    position = torch.arange(float(count)).double()
    centre = 0.8 * torch.sin(position / 40)
    width = half_width + 0.004 * position
    parameters = torch.stack(
        [centre, width, torch.full_like(centre, opacity), torch.full_like(centre, skew)], dim=-1
    )
    alpha = semi_ellipse(OFFSET, *parameters[:, :, None].unbind(1), torch.tensor(BLUR))
    ball = torch.tensor(BALL, dtype=torch.float64)
    clean_ground = torch.full((count, len(OFFSET), 3), GROUND, dtype=torch.float64)
    signal = alpha[..., None] * (ball - clean_ground) + clean_ground
    shape = signal.shape
    is_filled = torch.ones(1, *shape[:2], dtype=torch.bool)
    profiles = Profiles(
        origin=torch.stack([position, torch.zeros_like(position)], dim=-1)[None],
        normal=torch.tensor([0.0, 1.0]).double().expand(1, count, 2),
        position=position[None],
        offset=OFFSET.expand(1, count, -1),
        signal=(signal + noise * normal(*shape))[None],
        ground=(clean_ground + noise * normal(*shape))[None],
        smooth_ground=clean_ground[None],
        variance=torch.full((1, *shape), max(2 * noise**2, 1e-6), dtype=torch.float64),
        is_filled=is_filled,
        valid=is_filled,
    )
    return profiles, parameters


def picked(profiles, index):
    """Some of the profiles, in the order of the index."""
    return replace(profiles, **{name: getattr(profiles, name)[:, index] for name in FIELDS})


def found_parameters(fit):
    return torch.stack([fit.centre, fit.half_width, fit.opacity], dim=-1)[0]


UNIFORM = Uniform(colour=BALL)


def test_clean_profiles_come_back():
    profiles, truth = made_profiles(count=40, noise=0.0)
    fit = fit_profiles(profiles, UNIFORM, tolerance=1e-3, blur_rounds=12)
    assert fit.good.all()
    assert torch.allclose(found_parameters(fit), truth[:, :3], atol=2e-3)
    assert float(fit.blur[0]) == pytest.approx(BLUR, abs=0.01)


def test_shapes():
    profiles, _ = made_profiles(count=30)
    fit = fit_profiles(profiles, UNIFORM)
    assert fit.centre.shape == fit.half_width.shape == fit.opacity.shape == (1, 30)
    assert fit.skew.shape == fit.chi2_per_dof.shape == fit.flags.shape == (1, 30)
    assert fit.covariance.shape == (1, 30, 3, 3)
    assert fit.blur.shape == (1,)
    assert fit.middle.shape == (1, 30, 2)
    assert fit.edges.shape == (1, 30, 2, 2)
    assert (fit.samples == 3 * len(OFFSET)).all()


def test_edges_lie_half_a_width_to_either_side():
    profiles, _ = made_profiles(count=10)
    fit = fit_profiles(profiles, UNIFORM)
    left, right = fit.edges[0].unbind(1)
    assert torch.allclose((left + right) / 2, fit.middle[0])
    assert torch.allclose(right - left, 2 * fit.half_width[0][:, None] * fit.normal[0])


def test_errors_are_what_the_covariance_says():
    profiles, truth = made_profiles()
    fit = fit_profiles(profiles, UNIFORM)
    assert fit.good.double().mean() > 0.98
    error = found_parameters(fit) - truth[:, :3]
    z = error / fit.covariance[0].diagonal(dim1=-2, dim2=-1).sqrt()
    rms = z[fit.good[0]].pow(2).mean(0).sqrt()
    assert (rms > 0.85).all()
    assert (rms < 1.2).all()
    # the noise of the ground enters with (1 - alpha)^2 only, but is counted in full
    assert 0.8 < float(fit.chi2_per_dof.median()) < 1.05


def test_the_blur_is_found():
    blurs = [float(fit_profiles(made_profiles(seed=s)[0], UNIFORM).blur[0]) for s in range(3)]
    assert torch.tensor(blurs).mean() == pytest.approx(BLUR, abs=0.1)


def test_a_known_skew_is_taken_along():
    profiles, truth = made_profiles(skew=TRUE_SKEW, noise=0.002)
    known = Skew(mean=torch.full((1, 300), TRUE_SKEW, dtype=torch.float64), std=1e-3)
    fit = fit_profiles(profiles, UNIFORM, skew=known)
    assert (fit.skew - TRUE_SKEW).abs().max() < 5e-3
    assert (fit.centre[0] - truth[:, 0]).mean().abs() < 0.01
    without = fit_profiles(profiles, UNIFORM)
    assert (without.centre[0] - truth[:, 0]).mean().abs() > 0.1


def test_an_open_skew_is_found():
    profiles, _ = made_profiles(skew=0.2, noise=0.002)
    open_skew = Skew(mean=torch.zeros(1, 300, dtype=torch.float64), std=0.3)
    fit = fit_profiles(profiles, UNIFORM, skew=open_skew)
    assert float(fit.skew.mean()) == pytest.approx(0.2, abs=0.01)


def test_refining_takes_the_bias_away():
    """Single fits of faint profiles come out too wide; steps about the common course do not."""
    width_errors = []
    for seed in range(4):
        profiles, truth = made_profiles(seed=seed, noise=0.03)
        fit = fit_profiles(profiles, UNIFORM)
        fit = refine_profiles(profiles, UNIFORM, fit, truth[None])
        good = fit.good[0]
        z = (fit.half_width[0] - truth[:, 1]) / fit.covariance[0, :, 1, 1].sqrt()
        width_errors.append(float(z[good].mean()))
        assert float(z[good].pow(2).mean().sqrt()) == pytest.approx(1, abs=0.2)
    # the mean of 1200 profiles errs by 0.03
    assert abs(sum(width_errors) / 4) < 0.1


def test_refining_leaves_flagged_profiles_alone():
    profiles, truth = made_profiles(count=40)
    fit = fit_profiles(profiles, UNIFORM)
    flags = fit.flags.clone()
    flags[0, 5] = int(ProfileFlag.END)
    flags[0, 6] = int(ProfileFlag.NOT_CONVERGED)
    refined = refine_profiles(profiles, UNIFORM, replace(fit, flags=flags), truth[None])
    assert float(refined.centre[0, 5]) == float(fit.centre[0, 5])
    assert int(refined.flags[0, 5]) == int(ProfileFlag.END)
    # a linear step needs no search, so that it takes those along whose search failed
    assert int(refined.flags[0, 6]) == 0


def test_a_gross_error_hardly_pulls():
    profiles, truth = made_profiles(count=30)
    signal = profiles.signal.clone()
    signal[0, 11, 31] = 0.0  # a speck of dirt on the right half, 25 standard deviations deep
    clean = fit_profiles(profiles, UNIFORM)
    fit = fit_profiles(replace(profiles, signal=signal), UNIFORM)
    moved = (found_parameters(fit) - found_parameters(clean)).abs()[11]
    std = clean.covariance[0, 11].diagonal().sqrt()
    assert (moved < 5 * std).all()
    assert (found_parameters(fit)[11, 0] - truth[11, 0]).abs() < 1.5


def test_unusable_pixels_do_not_matter_but_are_flagged_when_many():
    profiles, _ = made_profiles(count=30)
    valid, signal = profiles.valid.clone(), profiles.signal.clone()
    valid[0, 3, :5] = False
    valid[0, 4, :20] = False
    signal[0, 3:5, :5] = 50.0
    fit = fit_profiles(replace(profiles, valid=valid, signal=signal), UNIFORM)
    assert int(fit.flags[0, 3]) == 0
    assert int(fit.flags[0, 4]) & int(ProfileFlag.CLIPPED)
    assert int(fit.samples[0, 3]) == 3 * (len(OFFSET) - 5)


def test_a_profile_without_a_ball_is_flagged_and_spoils_no_other():
    profiles, _ = made_profiles(count=60)
    signal = profiles.signal.clone()
    generator = torch.Generator().manual_seed(9)
    signal[0, 20] = GROUND + NOISE * torch.randn(45, 3, generator=generator).double()
    clean = fit_profiles(profiles, UNIFORM)
    fit = fit_profiles(replace(profiles, signal=signal), UNIFORM)
    assert int(fit.flags[0, 20]) & int(ProfileFlag.LOW_CONTRAST)
    others = torch.arange(60) != 20
    std = clean.covariance[0].diagonal(dim1=-2, dim2=-1).sqrt()
    moved = (found_parameters(fit) - found_parameters(clean)).abs()
    # the common blur is the only thing shared
    assert (moved[others] < 0.1 * std[others]).all()


def test_a_channel_that_was_not_measured_does_not_count():
    profiles, truth = made_profiles(count=60)
    variance, signal = profiles.variance.clone(), profiles.signal.clone()
    variance[..., 1] = torch.inf
    signal[..., 1] = 7.0
    fit = fit_profiles(replace(profiles, variance=variance, signal=signal), UNIFORM)
    assert (fit.samples == 2 * len(OFFSET)).all()
    z = (fit.centre[0] - truth[:, 0]) / fit.covariance[0, :, 0, 0].sqrt()
    assert 0.7 < float(z.pow(2).mean().sqrt()) < 1.4


@pytest.mark.parametrize("index", [0, 150, 299])
def test_one_profile_alone_gives_the_same_as_among_300(index):
    """At the same blur, which is one for the whole picture."""
    profiles, _ = made_profiles()
    together = fit_profiles(profiles, UNIFORM, blur_rounds=1)
    alone = fit_profiles(picked(profiles, [index]), UNIFORM, blur_rounds=1)
    assert torch.allclose(found_parameters(alone)[0], found_parameters(together)[index], rtol=1e-9)
    assert torch.allclose(alone.covariance[0, 0], together.covariance[0, index], rtol=1e-9)
    assert int(alone.flags[0, 0]) == int(together.flags[0, index])


def test_shuffled_profiles_give_the_shuffled_answer():
    profiles, _ = made_profiles(count=80)
    order = torch.randperm(80, generator=torch.Generator().manual_seed(0))
    straight, shuffled = (fit_profiles(p, UNIFORM) for p in (profiles, picked(profiles, order)))
    assert torch.allclose(found_parameters(shuffled), found_parameters(straight)[order], atol=1e-9)
    assert torch.equal(shuffled.flags[0], straight.flags[0][order])
    assert float(shuffled.blur[0]) == pytest.approx(float(straight.blur[0]), rel=1e-9)


def test_pictures_of_a_batch_keep_their_own_blur():
    one, _ = made_profiles(count=50, seed=1)
    two, _ = made_profiles(count=50, seed=2, opacity=0.4)
    both = replace(
        one,
        **{name: torch.cat([getattr(one, name), getattr(two, name)]) for name in FIELDS},
    )
    together = fit_profiles(both, UNIFORM, blur_rounds=2)
    for index, profiles in enumerate((one, two)):
        alone = fit_profiles(profiles, UNIFORM, blur_rounds=2)
        assert float(together.blur[index]) == pytest.approx(float(alone.blur[0]), abs=0.05)
        assert torch.allclose(together.centre[index], alone.centre[0], atol=0.02)
