import math
from dataclasses import replace

import pytest
import torch

from plugins.uniform import Uniform
from toolkit.sweep.explain import explain_misfit
from toolkit.sweep.fit import fit_sweep
from toolkit.sweep.marks import STRONGEST, find_marks, fit_with_marks
from toolkit.sweep.misfit import look_for_misfit, small_patches
from toolkit.synthetic import PanelledBall


def panelled(scene):
    """A football of dark pentagons that turns once and a half."""
    colour = scene.appearance.colour
    dark = tuple(0.4 * channel for channel in colour)
    rate = 3 * math.pi / scene.exposure
    spin = (0.3 * rate, 0.5 * rate, 0.8 * rate)
    return replace(scene, appearance=PanelledBall(colours=(colour, dark), spin=spin))


@pytest.fixture(scope="module")
def football(streak):
    one = streak(Uniform(), change=panelled, width_px=60, length_widths=2.0)
    plain = streak(Uniform(), width_px=60, length_widths=2.0)
    return replace(plain, shot=one.shot), plain.truth()


def fitted(seen, truth):
    frame = seen.frame()
    model = replace(seen.model(), estimator=Uniform()) if hasattr(seen, "model") else None
    return fit_sweep(model, truth, frame, doubt=1.0), frame


def true_state(seen):
    first, middle, last = seen.points(3)
    return torch.cat([middle, last - first])


def state(fit):
    return torch.cat(fit.state())


def std(fit, factor):
    k = fit.model.path.size
    covariance = fit.path_covariance * factor
    half = torch.tensor([[0.5, 0.5], [-1.0, 1.0]], dtype=torch.float64)
    J = torch.kron(half, torch.eye(3, dtype=torch.float64))
    assert k == 6
    return (J @ covariance @ J.mT).diagonal().sqrt()


def test_marks_are_found_and_bring_the_motion_nearer_to_the_truth(football):
    seen, truth = football
    fit, frame = fitted(seen, truth)
    assert look_for_misfit(fit).significant
    marked = fit_with_marks(fit, frame)
    assert marked.fit.converged
    assert marked.marks.width < 0.5
    assert 0.03 < marked.marks.strength < STRONGEST
    true = true_state(seen)
    before, after = ((state(one) - true).abs() for one in (fit, marked.fit))
    scale = std(marked.fit, marked.left.factor)
    assert (after < 3.5 * scale).all()
    assert float((after / scale).square().sum()) < float((before / scale).square().sum())
    assert marked.left.lanes < marked.before.lanes or marked.left.patches < marked.before.patches
    text = explain_misfit(marked.fit, marked)
    assert "dark and bright" in text
    assert "ball radii wide" in text


def test_a_ball_of_one_colour_has_no_marks(streak):
    seen = streak(width_px=60, length_widths=2.0)
    frames = [seen.again(seed).frame() for seed in range(6)]
    fits = [fit_sweep(seen.model(), seen.truth(), frame, doubt=1.0) for frame in frames]
    assert sum(find_marks(fit) is not None for fit in fits) <= 1
    assert explain_misfit(fits[0], None).startswith("shading, a pattern")


def test_the_strength_is_found_of_marks_that_are_there(streak):
    """Each cell of the largest size darker or lighter at random, by a tenth of the ball's light."""
    seen = streak(width_px=60, length_widths=2.0)
    fit = fit_sweep(seen.model(), seen.truth(), seen.clean().frame(), doubt=1.0)
    noise = torch.randn(fit.seen.residual.shape, generator=torch.Generator().manual_seed(1))
    cells = find_marks_grid(fit)
    lights = 0.1 * torch.randn(cells.count, generator=torch.Generator().manual_seed(5)).double()
    residual = noise.double() + fit.seen.light * cells.share * lights[cells.number]
    gradient = torch.zeros_like(fit.seen.gradient)
    for q, (J, at) in enumerate(zip(fit.seen.J, fit.seen.columns, strict=True)):
        gradient[at] -= J @ residual[q]
    marks = find_marks(replace(fit, seen=replace(fit.seen, residual=residual, gradient=gradient)))
    assert marks.strength == pytest.approx(0.1, rel=0.45)
    assert marks.wide == 4
    same = find_marks(fit_of(fit, residual, gradient), like=marks)
    assert same.strength == marks.strength
    other = find_marks(fit_of(fit, residual, gradient), other_than=marks)
    assert other.wide != marks.wide
    assert other.cost > marks.cost


def fit_of(fit, residual, gradient):
    return replace(fit, seen=replace(fit.seen, residual=residual, gradient=gradient))


def find_marks_grid(fit):
    from toolkit.sweep.cells import Cells
    from toolkit.sweep.marks import _grid, _shares

    grid = _grid(fit)
    number, count = grid.merged(4, 4)
    number = number[grid.lane * grid.stretches + grid.stretch]
    return Cells(number=number, count=count, share=_shares(fit))


def test_small_patches_are_smaller_and_hold_all_of_the_streak(streak):
    fit = streak(width_px=60, length_widths=2.0).fit()
    place, sigma = small_patches(fit)
    assert len(place) == len(sigma) > 3 * len(look_for_misfit(fit).patch_sigma)
    assert float(sigma.square().mean()) == pytest.approx(1, abs=0.2)
