"""What an estimator leaves open is found in the fit: here the colour of a uniform ball."""

from dataclasses import replace

import pytest
import torch

from plugins.uniform import Uniform
from toolkit import measure
from toolkit.alpha import Chord
from toolkit.appearance import guess_appearance
from toolkit.profiles import gather_profiles
from toolkit.streak_fit import fit_streak
from toolkit.synthetic import (
    benchmark_scene,
    flat_background,
    render_shot,
    textured_background,
)
from toolkit.synthetic.scenes import contrasting_colour
from toolkit.view import observe_streak

SCENE = benchmark_scene(width_px=50, length_widths=4, seed=2, tilt=0.2)


def run(shot, estimator, stage="sweep"):
    scene = shot.scene
    return measure(
        shot.image,
        shot.background,
        camera=scene.camera,
        ball_radius=scene.ball_radius,
        exposure=scene.exposure,
        estimator=estimator,
        stage=stage,
    )


def codes(result):
    return {caution.code for caution in result.warnings}


@pytest.fixture(scope="module")
def textured():
    size = SCENE.camera.width, SCENE.camera.height
    background = textured_background(*size, contrast=0.5, seed=5)
    return render_shot(replace(SCENE, background=background), seed=3)


@pytest.fixture(scope="module")
def flat():
    size = SCENE.camera.width, SCENE.camera.height
    background = flat_background(*size, (0.3, 0.32, 0.28))
    return render_shot(replace(SCENE, background=background), seed=3)


def test_settling_gives_an_estimator_of_that_colour():
    chord = Chord(offset=torch.zeros(2, 5), direction=torch.zeros(2, 1))
    colour = torch.tensor([0.1, 0.5, 0.7], dtype=torch.float64)
    settled = Uniform().settled(colour)
    assert Uniform().unknowns() == 3
    assert settled.unknowns() == Uniform(colour=(0.1, 0.5, 0.7)).unknowns() == 0
    known = Uniform(colour=(0.1, 0.5, 0.7)).foreground(chord, None)
    assert torch.equal(settled.foreground(chord, None), known)
    value, slope = settled.foreground_and_slope(chord)
    assert torch.equal(value, known)
    assert slope is None


def test_the_guess_from_the_streaks_shape_is_near(textured):
    view = observe_streak(textured.image, textured.background, Uniform())
    half_width = float(view.streak.half_width)
    profiles = gather_profiles(
        view.observation, view.clipped, view.streak.axis, 2 * half_width, corner=view.corner
    )
    guess = guess_appearance(profiles, half_width, Uniform())
    truth = torch.tensor(SCENE.appearance.colour, dtype=torch.float64)
    assert (guess.values - truth).abs().max() < 3 * guess.std < 0.4


def test_a_varying_background_tells_the_colour(textured):
    view = observe_streak(textured.image, textured.background, Uniform())
    found = fit_streak(view, Uniform())[0].appearance
    truth = torch.tensor(SCENE.appearance.colour, dtype=torch.float64)
    assert found.opacity_std < 0.02
    # an error of the opacity moves the colour found away from the background
    away = truth - textured.background.rgb.mean(dim=(0, 2, 3)).double()
    assert ((found.values - truth).abs() < 4 * found.opacity_std * away.abs() + 0.003).all()


def test_the_same_is_measured_as_with_the_colour_known(textured):
    known, found = run(textured, Uniform(colour=SCENE.appearance.colour)), run(textured, Uniform())
    assert "colour-from-length" not in codes(found)
    assert known.fit.appearance is None
    assert found.fit.appearance == pytest.approx(SCENE.appearance.colour, abs=0.02)
    gap = torch.tensor(known.position_m) - torch.tensor(found.position_m)
    assert (gap.abs() < torch.tensor(known.position_std_m)).all()
    truth = float(textured.velocity.norm())
    assert abs(found.speed_m_s - truth) < 3 * found.speed_std_m_s < 0.05 * truth
    assert found.speed_std_m_s > 0.8 * known.speed_std_m_s


@pytest.mark.parametrize("stage", ["contours", "sweep"])
def test_over_a_flat_background_the_length_tells_the_speed(flat, stage):
    result = run(flat, Uniform(), stage)
    # contours alone know no ends, so that they must say where the colour comes from
    assert ("colour-from-length" in codes(result)) == (stage == "contours")
    truth = float(flat.velocity.norm())
    assert abs(result.speed_m_s - truth) < 3 * result.speed_std_m_s < 0.06 * truth
    error = torch.tensor(result.position_m) - flat.position
    assert (error.abs() < 4 * torch.tensor(result.position_std_m)).all()


def test_a_curved_path_needs_no_colour_either():
    scene = benchmark_scene(width_px=60, length_widths=5, seed=7, sagitta_widths=0.7)
    scene = replace(
        scene,
        background=textured_background(
            scene.camera.width, scene.camera.height, contrast=0.3, seed=5
        ),
    )
    scene = replace(
        scene,
        appearance=replace(scene.appearance, colour=contrasting_colour(scene.background, 0.4)),
    )
    shot = render_shot(scene, seed=3)
    result = run(shot, Uniform())
    error = torch.tensor(result.position_m) - shot.position
    assert (error.abs() < 4 * torch.tensor(result.position_std_m)).all()
    truth = float(shot.velocity.norm())
    assert abs(result.speed_m_s - truth) < 3 * result.speed_std_m_s < 0.1 * truth
