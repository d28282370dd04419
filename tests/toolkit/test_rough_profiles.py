"""The first look at a streak, from which the search among all its pixels starts."""

import pytest
import torch

from plugins.uniform import Uniform
from toolkit.errors import StreakError
from toolkit.sketch import sketch_motion, smooth_edges
from toolkit.streak_fit import fit_roughly, fit_streak
from toolkit.synthetic import benchmark_scene, render_shot
from toolkit.view import observe_streak

SCENES = {
    "straight": benchmark_scene(width_px=44, length_widths=4, tilt=0.3, seed=5),
    "curved": benchmark_scene(width_px=44, length_widths=5, sagitta_widths=0.8, seed=3),
}


@pytest.fixture(scope="module", params=SCENES)
def seen(request):
    scene = SCENES[request.param]
    shot = render_shot(scene, seed=2)
    return shot, observe_streak(shot.image, shot.background, Uniform())


@pytest.mark.parametrize("is_known", [True, False], ids=["colour given", "colour open"])
def test_the_motion_is_roughly_right(seen, is_known):
    shot, view = seen
    scene, colour = shot.scene, torch.tensor(shot.scene.appearance.colour)
    estimator = Uniform(colour=scene.appearance.colour if is_known else None)
    fit = fit_roughly(view, estimator)
    assert (fit.appearance is None) is is_known
    found = sketch_motion(fit, scene.camera, scene.ball_radius).path
    path = scene.path.position(torch.linspace(0, scene.exposure, len(found)).double())
    if float((found[0] - path[0]).norm()) > float((found[0] - path[-1]).norm()):
        path = path.flip(0)
    pixels = (scene.camera.project(p) for p in (found, path))
    apart = torch.linalg.vector_norm(torch.sub(*pixels), dim=-1)
    assert apart.max() < 0.15 * 22  # half widths
    assert (found[:, 2] / path[:, 2] - 1).abs().max() < 0.03
    edges = smooth_edges(fit)
    width = torch.linalg.vector_norm(edges[:, 1] - edges[:, 0], dim=-1)
    assert (width / 44 - 1).abs().max() < 0.15  # nearer and farther than in the middle
    if not is_known:
        assert (fit.appearance.values - colour).abs().max() < 0.2


def test_it_looks_at_fewer_profiles(seen):
    shot, view = seen
    estimator = Uniform(colour=shot.scene.appearance.colour)
    rough, whole = fit_roughly(view, estimator), fit_streak(view, estimator)[0]
    assert rough.good.sum() < 0.6 * whole.good.sum()
    widths = [fit.half_width[0][fit.good[0]].median() for fit in (rough, whole)]
    assert float(widths[0]) == pytest.approx(float(widths[1]), rel=0.02)


def test_a_short_streak_has_too_few_profiles():
    scene = benchmark_scene(width_px=44, length_widths=1, seed=5)
    shot = render_shot(scene, seed=2)
    view = observe_streak(shot.image, shot.background, Uniform())
    with pytest.raises(StreakError, match="profiles are usable"):
        fit_roughly(view, Uniform())
