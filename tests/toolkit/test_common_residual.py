from dataclasses import replace

import pytest

from plugins.uniform import Uniform
from toolkit import StreakError, measure
from toolkit.common_residual import MISSHAPEN, misfit_variance
from toolkit.streak_fit import fit_streak
from toolkit.synthetic import LambertBall, benchmark_scene, mean_colour, render_shot
from toolkit.view import observe_streak

SCENE = benchmark_scene(width_px=60, length_widths=4, seed=6, tilt=0.1)


def fit_of(shot, estimator):
    return fit_streak(observe_streak(shot.image, shot.background, estimator), estimator)[0]


def run(shot, estimator, stage="contours"):
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


@pytest.fixture(scope="module")
def plain():
    return render_shot(SCENE, seed=1)


@pytest.fixture(scope="module")
def shaded():
    ball = LambertBall(colour=SCENE.appearance.colour, ambient=0.4)
    return render_shot(replace(SCENE, appearance=ball), seed=1)


def shaded_colour(shot):
    return mean_colour(shot.scene.appearance, shot.scene.exposure)


def test_noise_alone_averages_out(plain):
    fit = fit_of(plain, Uniform(colour=SCENE.appearance.colour))
    assert 0.4 < fit.common_misfit < 1.6
    assert misfit_variance(fit) == 1


def test_shade_shows_in_what_profiles_miss_alike_though_each_is_fitted_well(shaded):
    fit = fit_of(shaded, Uniform(colour=shaded_colour(shaded)))
    assert float(fit.chi2_per_dof[0][fit.good[0]].median()) < 2
    assert fit.common_misfit > 10 * MISSHAPEN
    assert misfit_variance(fit) > fit.common_misfit


def test_a_shaded_ball_taken_for_one_colour_is_told_and_widens_the_answer(shaded, plain):
    wrong = run(shaded, Uniform(colour=shaded_colour(shaded)))
    right = run(plain, Uniform(colour=SCENE.appearance.colour))
    told = {caution.code: caution.message for caution in wrong.warnings}
    # the one in use may be among those that a list would name
    assert "another estimator may suit the ball" in told["profiles-misshapen"]
    assert "profiles-misshapen" not in {caution.code for caution in right.warnings}
    assert wrong.position_std_m[2] > 5 * right.position_std_m[2]


def test_no_colour_is_found_for_a_shaded_ball(shaded):
    with pytest.raises(StreakError, match="not of one colour that the fit could find"):
        run(shaded, Uniform())
