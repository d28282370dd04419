"""The rough motion that short streaks start from, against rendered truth."""

import pytest
import torch

from plugins.uniform import Uniform
from toolkit.rough_motion import rough_motion
from toolkit.synthetic import NoiseLevel, benchmark_scene, render_shot
from toolkit.view import observe_streak

TENTH = 0.1


def rendered(width, length, noise=0.01, seed=0, **scene):
    level = NoiseLevel(read=noise)
    return render_shot(
        benchmark_scene(width_px=width, length_widths=length, noise=level, seed=seed, **scene),
        seed=seed,
    )


def roughly_moved(shot, estimator):
    view = observe_streak(shot.image, shot.background, estimator)
    return rough_motion(view, estimator, shot.scene.camera, shot.scene.ball_radius)


def true_path(shot, found):
    """The true path at the same shares of the exposure, in the direction that was found."""
    time = torch.linspace(0, shot.scene.exposure, len(found.path), dtype=torch.float64)
    path = shot.scene.path.position(time)
    return path if ((path[-1] - path[0]) @ (found.path[-1] - found.path[0])) > 0 else path.flip(0)


def check_near(shot, found):
    """Centres within a tenth of the ball's image, depths within a tenth, 0.2 widths of length."""
    camera, truth = shot.scene.camera, true_path(shot, found)
    middle = len(truth) // 2
    half_width = camera.fx * shot.scene.ball_radius / float(truth[middle].norm())
    pixels, true_pixels = camera.project(found.path), camera.project(truth)
    assert float((pixels - true_pixels)[middle].norm()) < TENTH * half_width
    assert float(found.path[middle].norm() / truth[middle].norm()) == pytest.approx(1, abs=TENTH)
    length, true_length = (
        float(p.diff(dim=0).norm(dim=-1).sum()) / (2 * half_width) for p in (pixels, true_pixels)
    )
    assert length == pytest.approx(true_length, abs=0.2)


@pytest.mark.parametrize("is_known", [True, False])
@pytest.mark.parametrize(
    ("width", "length", "noise"), [(20, 1.0, 0.03), (40, 0.7, 0.01), (60, 2.5, 0.02)]
)
def test_a_short_streak_says_roughly_how_the_ball_moved(width, length, noise, is_known):
    shot = rendered(width, length, noise, tilt=0.4, seed=width)
    colour = shot.scene.appearance.colour
    found = roughly_moved(shot, Uniform(colour=colour) if is_known else Uniform())
    check_near(shot, found)
    assert found.corner is None
    if is_known:
        assert found.colour is None
    else:
        assert torch.allclose(found.colour, torch.tensor(colour).double(), atol=0.03)
