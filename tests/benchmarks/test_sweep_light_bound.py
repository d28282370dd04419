import numpy as np
import pytest
import torch
from sweep_balls import KINDS, paint
from sweep_light_bound import LightBound, rendered_basis
from sweep_scenes import draw_scene, render

from toolkit.shade_basis import dense_basis

SEED = 100015


@pytest.fixture(scope="module")
def bound():
    shot = render(paint(KINDS["shaded, seen"], draw_scene(SEED), SEED), SEED)
    return LightBound(shot, SEED)


def test_numbers_of_a_shade_are_rendered_as_the_renderer_does(bound):
    chosen = [0, 1, 3]

    def look(normal, _):
        return dense_basis(bound.unit(normal.double()))[:, chosen].to(normal)

    own = rendered_basis(bound)[:, chosen]
    assert float(own.max()) > 0.95
    assert float((own - bound.picture(look)).abs().max()) < 1e-4


def test_the_less_is_known_of_the_light_the_higher_the_bound(bound):
    known, family, smooth = (
        one() for one in (bound.of_known_light, bound.of_known_family, bound.of_smooth_light)
    )
    assert np.all(known < family)
    assert np.all(family < smooth * (1 + 1e-4))
    assert np.all(smooth < 1.1 * known)


def test_the_known_light_is_that_of_the_ball(bound):
    """At the true motion in the true light there is nothing left but noise."""
    seen = bound.fit.seen
    covered = seen.coverage.alpha > 0.1
    misfit = float(seen.residual[:, covered].square().mean())
    assert misfit == pytest.approx(1, abs=0.1)
    assert torch.isfinite(bound.fit.covariance).all()
