from dataclasses import replace
from types import SimpleNamespace

import pytest
import torch

from toolkit.motion import DEPTH, DURATION, SPEED
from toolkit.sweep.doubt import J_state, motion_of, sweep_uncertainty
from toolkit.sweep.fit import fit_sweep
from toolkit.sweep.likelihood import compare
from toolkit.sweep.paths import PARABOLA, STRAIGHT

QUIET = SimpleNamespace(factor=1.0)
KEPT = [0, 1, 2, 3, 4, 5, SPEED]  # position, displacement, speed


@pytest.fixture(scope="module")
def seen(streak):
    return streak(length_widths=2.0, distance_R=20.0, tilt=0.3)


def doubt_of(fit, **changes):
    options = {
        "others": (),
        "ball_radius_std": 0.0,
        "exposure_std_share": 0.0,
        "response_changes": torch.zeros(0),
    }
    return sweep_uncertainty(fit, QUIET, **(options | changes))


@pytest.mark.parametrize("path", [STRAIGHT, PARABOLA], ids=["straight", "parabola"])
def test_the_state_changes_with_the_path_as_told(seen, path, differences):
    fit = seen.fit(path)
    k = path.size

    def state(shape):
        return motion_of(replace(fit, parameters=torch.cat([shape, fit.parameters[k:]]))).state()

    J = differences(state, fit.parameters[:k], torch.full((k,), 1e-6, dtype=torch.float64))
    assert torch.allclose(J_state(fit), J, atol=1e-6)


def test_noise_is_the_inverse_of_the_information(seen):
    fit = seen.fit()
    J, covariance = J_state(fit), torch.linalg.inv(fit.seen.information)[:6, :6]
    expected = J @ covariance @ J.mT
    noise = doubt_of(fit).noise
    assert torch.allclose(noise, expected, rtol=1e-6, atol=1e-9 * float(expected.abs().max()))
    wider = sweep_uncertainty(
        fit,
        SimpleNamespace(factor=3.0),
        others=(),
        ball_radius_std=0.0,
        exposure_std_share=0.0,
        response_changes=torch.zeros(0),
    )
    assert torch.allclose(wider.noise, 3 * noise)


def test_nothing_is_known_of_a_camera_without_covariance(seen):
    uncertainty = doubt_of(seen.fit())
    assert uncertainty.camera is None
    assert torch.equal(uncertainty.total, uncertainty.noise)


def with_covariance(seen, std):
    """The scene's camera, known by as much."""
    camera = seen.scene.camera
    return replace(camera, covariance=torch.diag(torch.tensor(std, dtype=torch.float64) ** 2))


@pytest.mark.parametrize("distortion", [(), (-0.2, 0.05, 0.0, 0.0, 0.0)], ids=["none", "some"])
def test_the_camera_s_covariance_is_what_refitting_through_others_gives(streak, distortion):
    seen = streak(length_widths=2.0, distance_R=20.0, tilt=0.3, distortion=distortion)
    std = [1.5, 1.5, 0.8, 0.6] + [0.004] * len(distortion)
    camera = with_covariance(seen, std)
    fit = seen.fit()
    known = replace(fit, model=replace(fit.model, camera=camera))
    told = doubt_of(known).camera
    frame, columns = seen.frame(), []
    for index, size in enumerate(std):
        shift = torch.zeros(len(std), dtype=torch.float64)
        shift[index] = size
        states = []
        for sign in (1.0, -1.0):
            other = camera.with_parameters(camera.parameters + sign * shift)
            model = replace(fit.model, camera=other)
            moved = fit_sweep(model, fit.parameters, replace(frame, camera=other), doubt=1.0)
            # to the very end
            step, _ = compare(model, moved.parameters, moved.pixels).step()
            moved = replace(moved, parameters=moved.parameters + step)
            states.append(motion_of(moved).state()[KEPT])
        columns.append((states[0] - states[1]) / 2)
    change = torch.stack(columns, dim=-1)
    expected = (change @ change.mT).diagonal().sqrt()
    found = told.diagonal()[KEPT].sqrt()
    assert torch.allclose(found, expected, rtol=0.1, atol=0.02 * float(expected.max()))
    assert float(found[DEPTH]) == pytest.approx(float(expected[DEPTH]), rel=0.05)


def test_a_camera_known_exactly_adds_nothing(seen):
    fit = seen.fit()
    camera = with_covariance(seen, [0.0] * 4)
    known = replace(fit, model=replace(fit.model, camera=camera))
    assert not doubt_of(known).camera.any()


def test_all_lengths_scale_with_the_radius_exactly(seen):
    fit = seen.fit()
    # a ball one per cent larger, everything farther by as much, looks the same
    model = replace(fit.model, ball_radius=1.01 * fit.model.ball_radius)
    x = fit.parameters.clone()
    x[:6] *= 1.01
    same = compare(fit.model, fit.parameters, fit.pixels)
    assert compare(model, x, fit.pixels).cost == pytest.approx(same.cost, rel=1e-9)
    state = motion_of(fit).state()
    by_radius = doubt_of(fit, ball_radius_std=0.01 * fit.model.ball_radius).radius
    change = motion_of(replace(fit, parameters=x)).state() - state
    assert torch.allclose(by_radius, torch.outer(change, change), rtol=1e-9, atol=1e-15)
    assert float(by_radius[DURATION, DURATION]) == 0


def test_the_exposure_acts_on_speeds_alone(seen):
    fit = seen.fit()
    state = motion_of(fit).state()
    by_exposure = doubt_of(fit, exposure_std_share=0.03).exposure
    std = by_exposure.diagonal().sqrt()
    assert torch.allclose(std[3 : SPEED + 1], 0.03 * state[3 : SPEED + 1].abs())
    assert (std[:3] == 0).all()
    assert (std[SPEED + 1 :] == 0).all()


def test_another_response_moves_the_answer_as_told(seen):
    """The whole picture to a power one per cent higher, fitted again."""
    fit, frame = seen.fit(), seen.frame()
    power = 1.01
    other = replace(frame, signal=frame.signal**power, ground=frame.ground**power)
    refitted = fit_sweep(seen.model(), fit.parameters, other, doubt=1.0)
    expected = (motion_of(refitted).state() - motion_of(fit).state())[KEPT]
    x, y = fit.pixels.place.long().mT
    rest = 1 - fit.seen.coverage.alpha
    signal, ground = (light[:, y, x].double() for light in (other.signal, other.ground))
    change = signal - fit.pixels.signal - rest * (ground - fit.pixels.ground)
    told = doubt_of(fit, response_changes=change[None]).brightness.diagonal()[KEPT].sqrt()
    assert torch.allclose(told, expected.abs(), rtol=0.15, atol=0.1 * float(expected.abs().max()))
    # where nobody names the response, by five per cent, it counts for more than noise
    assert 5 * float(told[-1]) > float(doubt_of(fit).noise[SPEED, SPEED].sqrt())


def test_what_a_finer_shade_changes_counts_as_one_standard_deviation(seen):
    fit = seen.fit()
    x = fit.parameters.clone()
    x[:6] += 0.01 * seen.scene.ball_radius
    finer = replace(fit, parameters=x)
    order = doubt_of(fit, others=(finer,)).order
    change = motion_of(finer).state() - motion_of(fit).state()
    assert torch.allclose(order, torch.outer(change, change))


def test_the_sources_add_up(seen):
    fit = seen.fit()
    parts = doubt_of(fit, ball_radius_std=1e-3, exposure_std_share=0.02)
    total = parts.noise + parts.order + parts.radius + parts.exposure + parts.brightness
    assert torch.allclose(parts.total, total)
