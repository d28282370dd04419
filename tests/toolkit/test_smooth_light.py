import math
from dataclasses import replace

import torch

from toolkit.disc import view_ball
from toolkit.smooth_light import fit_smooth_light
from toolkit.smooth_pixels import SmoothPixels
from toolkit.synthetic import LambertBall, StripedBall

LAMP = (0.5, 0.2, -0.8)


def frontal(colour):
    return LambertBall(colour=colour, light=LAMP, ambient=0.4)


def striped(colour):
    return StripedBall(colours=(colour, (0.95, 0.04, 0.03)), stripes=3, pole=(0.9, 0.4, -0.2))


def test_shade_disc_and_what_is_left_open_are_found_together(sharp_ball):
    sharp, empty = sharp_ball(frontal, radius_px=25, distance_R=200)
    view = view_ball(sharp.image, empty)
    smooth = fit_smooth_light(view)
    found = torch.tensor(smooth.disc.centre) + torch.tensor(view.corner)
    assert float((found - torch.tensor(sharp.disc.centre)).norm()) < 3.5 * smooth.disc.std
    assert 0 < smooth.disc.std < 0.1
    line = torch.linspace(-1, 1, 65, dtype=torch.float64)
    place = torch.stack(torch.meshgrid(line, line, indexing="xy"), dim=-1)
    place = place[torch.linalg.vector_norm(place, dim=-1) < 0.99]
    facing = (1 - (place * place).sum(-1, keepdim=True)).sqrt()
    true = frontal((1.0, 1.0, 1.0))(torch.cat([place, -facing], dim=-1), 0.0)
    x, y = (round(c) for c in sharp.disc.centre)
    true = true / frontal((1.0, 1.0, 1.0))(torch.tensor([[0, 0, -1.0]]).double(), 0.0)
    error = smooth.at(place) - true * sharp.clean_image[:, y, x].double()
    said = float(smooth.errors(place).square().sum(0).mean().sqrt())
    assert 0 < said < 0.005  # noise of a pixel is 0.01
    assert math.sqrt(float(error.square().mean())) < 2 * said


def test_a_ball_near_by_and_askew_is_laid_out_as_it_is_seen(sharp_ball):
    """Where a perspective was left out, the shade would miss by more than it says."""
    sharp, empty = sharp_ball(frontal, radius_px=30, distance_R=12)
    smooth = fit_smooth_light(view_ball(sharp.image, empty))
    said = float(smooth.near_errors[:, 0].square().sum().sqrt())
    assert said < 0.03
    assert abs(float(smooth.near[0]) - 1 / 12) < 3.5 * said


def test_a_dark_ball_s_noise_is_its_own(sharp_ball):
    """The background's tells of another brightness."""
    sharp, empty = sharp_ball(frontal, radius_px=30, distance_R=100)
    view = view_ball(sharp.image, empty)
    wrong = replace(view, noise=replace(view.noise, read_variance=2 * view.noise.read_variance))
    right, corrected = (SmoothPixels.of(v) for v in (view, wrong))
    assert (corrected.excess < 0.75 * right.excess).all()
    assert ((right.excess - 1).abs() < 0.25).all()


def test_a_pattern_is_no_smooth_shade(sharp_ball):
    sharp, empty = sharp_ball(striped, radius_px=25, distance_R=200)
    assert fit_smooth_light(view_ball(sharp.image, empty)) is None
